/* An example firmware for a tactiled board: timer, read-out through a table, commands, queues.
 *
 * Nothing here names a register: a microcontroller is a port (firmware.h). Like tactiled_board.c it is right
 * where a char has 16 bits. Interrupts only fill and empty queues; every frame is built in the main loop:
 *
 *     timer -> firmware_timer_fired -> scans -> main loop -> transmit queue -> firmware_next_octet -> UART
 *     UART -> firmware_octet_received -> receive queue -> main loop -> commands
 *
 * Each queue has one writer and one reader. The writer alone moves its end, the reader alone its beginning,
 * so neither needs a lock where a 16-bit store is one instruction.
 */
#include "firmware.h"

/* ---- yours: identity, line, channels --------------------------------------------------------------- */

#define FIRMWARE_VERSION "example-1"
#define BOARD_SERIAL "TB-EXAMPLE" /* different on each board: read it from flash */
#define ARRAY_ID "wang2019-3x3"
#define DEFAULT_RATE_MILLIHERTZ 100000u
#define ADC_BITS 12u
#define ADC_REFERENCE_MILLIVOLTS 3000u
#define SAMPLE_US 80u /* from one channel to the next: measure it, see bring-up.md, "Scan skew" */

/* Input of the multiplexer for each channel, in the order of the wire (channel = 4 * taxel + k). This board
 * has the nine R1 on inputs 0 to 8, the nine R2 on inputs 9 to 17, and so on. */
static const uint_least16_t INPUT_OF_CHANNEL[TACTILED_CHANNELS] = {
    0, 9, 18, 27, 1, 10, 19, 28, 2, 11, 20, 29, 3, 12, 21, 30, 4, 13,
    22, 31, 5, 14, 23, 32, 6, 15, 24, 33, 7, 16, 25, 34, 8, 17, 26, 35,
};

/* ---- scans: written by the timer's interrupt, read by the main loop -------------------------------- */

#define SCANS 4u /* a power of two: the main loop may be three periods late */
#define SLOWEST_MILLIHERTZ 100u

volatile firmware_faults_t firmware_faults;

static tactiled_scan scans[SCANS];
static volatile uint_least16_t scans_written, scans_read;
static volatile int running;
static uint_least16_t sequence; /* of the next scan */
static uint_least16_t next_flags;
static uint_least32_t due_us; /* when the next scan begins */
static uint_least32_t period_us;

static void miss_scan(void)
{
    sequence++;
    next_flags |= TACTILED_OVERRUN;
    firmware_faults.scans_missed++;
}

/* Samples all channels, and gives the scan the instant at which the timer fired, not the present one. */
static void take_scan(void)
{
    tactiled_scan *scan = &scans[scans_written % SCANS];
    unsigned channel;
    if ((uint_least16_t)(scans_written - scans_read) >= SCANS) {
        miss_scan();
        return;
    }
    scan->sequence = sequence++;
    scan->ticks_us = due_us;
    scan->flags = next_flags;
    next_flags = 0u;
    if (!port_reference_good()) {
        scan->flags |= TACTILED_REFERENCE_FAULT;
    }
    for (channel = 0u; channel < TACTILED_CHANNELS; channel++) {
        scan->counts[channel] = port_convert(INPUT_OF_CHANNEL[channel]);
    }
    scans_written++;
}

void firmware_timer_fired(void)
{
    uint_least32_t late_us = port_ticks_us() - due_us;
    if (!running) {
        return; /* was pending when the main loop stopped the timer */
    }
    if (late_us >= 0x80000000u) {
        if (0u - late_us > period_us / 64u) {
            return; /* was pending: the timer was begun anew, or the interrupt before this one came late */
        }
        due_us += late_us; /* a timer that is up to 1.5 % faster than the board clock */
        late_us = 0u;
    }
    while (late_us >= period_us) { /* interrupts were away for so long that the timer has fired again */
        miss_scan();
        due_us += period_us;
        late_us -= period_us;
    }
    take_scan();
    due_us += period_us;
}

/* ---- transmit queue: written by the main loop, read by the UART's interrupt ------------------------ */

#define TRANSMIT_OCTETS 1024u /* a power of two: a hello, seven scans and some acknowledges */
#define RESERVED_FOR_ACKNOWLEDGES (8u * TACTILED_ACKNOWLEDGE_OCTETS)
#define RESERVED_FOR_HELLO (RESERVED_FOR_ACKNOWLEDGES + TACTILED_HELLO_OCTETS)

static tactiled_octet transmit[TRANSMIT_OCTETS];
static volatile uint_least16_t transmit_written, transmit_read;
static tactiled_octet frame[TACTILED_HELLO_OCTETS]; /* the longest one */

/* Queues a whole frame and returns 1, or none of it and 0 where it would leave less room than is reserved. */
static int send_frame(size_t octets, size_t reserved)
{
    uint_least16_t end = transmit_written;
    size_t i;
    if (octets + reserved > TRANSMIT_OCTETS - (uint_least16_t)(end - transmit_read)) {
        firmware_faults.frames_dropped++;
        return 0;
    }
    for (i = 0u; i < octets; i++) {
        transmit[(uint_least16_t)(end + i) % TRANSMIT_OCTETS] = frame[i];
    }
    transmit_written = (uint_least16_t)(end + octets);
    port_transmit();
    return 1;
}

int firmware_next_octet(uint_least16_t *octet)
{
    if (transmit_read == transmit_written) {
        return 0;
    }
    *octet = (uint_least16_t)transmit[transmit_read % TRANSMIT_OCTETS];
    transmit_read++;
    return 1;
}

/* ---- receive queue: written by the UART's interrupt, read by the main loop ------------------------- */

#define RECEIVE_OCTETS 64u /* a power of two: 5.6 ms of the line at 115200 baud */

static tactiled_octet received[RECEIVE_OCTETS];
static volatile uint_least16_t received_written, received_read;

void firmware_octet_received(uint_least16_t octet)
{
    if ((uint_least16_t)(received_written - received_read) >= RECEIVE_OCTETS) {
        firmware_faults.octets_dropped++; /* the checksum of its frame fails, and the host repeats it */
        return;
    }
    received[received_written % RECEIVE_OCTETS] = (tactiled_octet)(octet & 0xFFu);
    received_written++;
}

/* ---- commands -------------------------------------------------------------------------------------- */

static uint_least16_t boots;
static uint_least32_t hello_us; /* when the last hello was built */
static tactiled_receiver receiver;

static void say_hello(void)
{
    tactiled_hello hello;
    unsigned channel;
    hello_us = port_ticks_us();
    hello.protocol_version = TACTILED_PROTOCOL_VERSION;
    hello.firmware_version = FIRMWARE_VERSION;
    hello.board_serial = BOARD_SERIAL;
    hello.array_id = ARRAY_ID;
    hello.boot_count = boots;
    hello.streaming = (uint_least16_t)running;
    hello.ticks_us = hello_us;
    hello.rate_millihertz = (1000000000u + period_us / 2u) / period_us;
    hello.adc_bits = ADC_BITS;
    hello.adc_reference_millivolts = ADC_REFERENCE_MILLIVOLTS;
    for (channel = 0u; channel < TACTILED_CHANNELS; channel++) {
        hello.channel_offset_us[channel] = (uint_least16_t)(channel * SAMPLE_US);
    }
    (void)send_frame(tactiled_encode_hello(&hello, frame), RESERVED_FOR_ACKNOWLEDGES);
}

#if DEFAULT_RATE_MILLIHERTZ < SLOWEST_MILLIHERTZ || \
    DEFAULT_RATE_MILLIHERTZ > TACTILED_LARGEST_RATE_MILLIHERTZ(BAUD) || \
    1000000000u / DEFAULT_RATE_MILLIHERTZ <= TACTILED_CHANNELS * SAMPLE_US
#error "the board cannot keep DEFAULT_RATE_MILLIHERTZ: see period_of"
#endif

/* Period of a rate, to the nearest microsecond: 0.05 % at 1 kHz; 0 for a rate that the board cannot keep. */
static uint_least32_t period_of(uint_least32_t rate_millihertz)
{
    uint_least32_t period;
    if (rate_millihertz < SLOWEST_MILLIHERTZ || rate_millihertz > tactiled_largest_rate_millihertz(BAUD)) {
        return 0u;
    }
    period = (1000000000u + rate_millihertz / 2u) / rate_millihertz;
    return period > TACTILED_CHANNELS * SAMPLE_US ? period : 0u;
}

static void start(void)
{
    port_lock();
    due_us = port_ticks_us();
    port_timer_start(period_us);
    port_unlock();
    next_flags |= TACTILED_FIRST_AFTER_START;
    take_scan(); /* the first scan at once; the UART goes on, and the timer has no effect until `running` */
    port_lock();
    due_us += period_us;
    running = 1;
    port_unlock();
}

static void stop(void)
{
    port_lock();
    running = 0;
    port_timer_stop();
    /* Scans that wait are not sent. Give their numbers back: nothing was lost but what they tell to be. */
    while (scans_written != scans_read) {
        scans_written = (uint_least16_t)(scans_written - 1u);
        sequence = (uint_least16_t)(sequence - 1u);
        next_flags |= (uint_least16_t)(scans[scans_written % SCANS].flags & TACTILED_OVERRUN);
    }
    port_unlock();
}

static uint_least16_t set_rate(uint_least32_t rate_millihertz)
{
    uint_least32_t period = period_of(rate_millihertz);
    if (period == 0u) {
        return TACTILED_BAD_ARGUMENT;
    }
    port_lock();
    period_us = period;
    if (running) {
        due_us = port_ticks_us() + period;
        port_timer_start(period);
    }
    port_unlock();
    return TACTILED_OK;
}

static uint_least16_t obey(const tactiled_command *command)
{
    switch (command->type) {
    case TACTILED_START:
        if (!running) {
            start();
        }
        return TACTILED_OK;
    case TACTILED_STOP:
        if (running) {
            stop();
        }
        return TACTILED_OK;
    case TACTILED_SET_RATE:
        return set_rate(command->rate_millihertz);
    case TACTILED_IDENTIFY:
        say_hello();
        return TACTILED_OK;
    default: /* ping */
        return TACTILED_OK;
    }
}

/* Carries out a command and answers it; of a repeated one only the answer was lost. */
static void answer(const tactiled_command *command, int known)
{
    static tactiled_command newest;
    static uint_least16_t result;
    static int any;
    tactiled_acknowledge acknowledge;
    if (!any || command->type != newest.type || command->token != newest.token ||
        command->rate_millihertz != newest.rate_millihertz) {
        result = known ? obey(command) : TACTILED_UNKNOWN_COMMAND;
        newest.type = command->type;
        newest.token = command->token;
        newest.rate_millihertz = command->rate_millihertz;
        any = 1;
    }
    acknowledge.token = command->token;
    acknowledge.command = command->type;
    acknowledge.result = result;
    acknowledge.ticks_us = port_ticks_us(); /* after the delimiter of the command came */
    (void)send_frame(tactiled_encode_acknowledge(&acknowledge, frame), 0u);
}

static void receive_octets(void)
{
    tactiled_command command;
    while (received_read != received_written) {
        uint_least16_t octet = (uint_least16_t)received[received_read % RECEIVE_OCTETS];
        received_read++;
        switch (tactiled_receive(&receiver, octet, &command)) {
        case TACTILED_RECEIVED_COMMAND:
            answer(&command, 1);
            break;
        case TACTILED_RECEIVED_UNKNOWN:
            answer(&command, 0);
            break;
        case TACTILED_RECEIVED_CORRUPT:
            firmware_faults.frames_corrupt++;
            break;
        case TACTILED_RECEIVED_NOTHING:
            break;
        }
    }
}

/* ---- main loop --------------------------------------------------------------------------------------- */

void firmware_run(uint_least16_t boot_count)
{
    uint_least16_t dropped = 0u; /* flag of the next scan: the one before it found no room */
    boots = boot_count;
    period_us = period_of(DEFAULT_RATE_MILLIHERTZ);
    say_hello();
    for (;;) {
        receive_octets();
        while (scans_read != scans_written) {
            tactiled_scan *scan = &scans[scans_read % SCANS];
            size_t octets;
            scan->flags |= dropped;
            octets = tactiled_encode_scan(scan, frame);
            scans_read++;
            dropped = send_frame(octets, RESERVED_FOR_HELLO) ? 0u : TACTILED_OVERRUN;
        }
        if (!running && port_ticks_us() - hello_us >= 1000000u) {
            say_hello();
        }
        port_feed_watchdog(); /* here alone: an interrupt would feed it while this loop hangs */
        port_wait();
    }
}
