/* The board's end of the tactiled protocol, version 1 (see ../board.md).
 *
 * C99 without allocation, recursion, memcpy, sizeof or any type of eight bits, so that it is right where
 * a char has 16 bits (TI C28x) as well as where it has 8. One octet of the wire travels in one
 * tactiled_octet; only its lower eight bits count on the way in, and no other bit is set on the way out.
 */
#ifndef TACTILED_BOARD_H
#define TACTILED_BOARD_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Any unsigned type of at least eight bits; define TACTILED_OCTET where the serial driver has its own. */
#ifdef TACTILED_OCTET
typedef TACTILED_OCTET tactiled_octet;
#else
typedef uint_least16_t tactiled_octet;
#endif

#define TACTILED_PROTOCOL_VERSION 1u
#define TACTILED_CHANNELS 36u

/* Octets on the wire, the closing 0x00 included. */
#define TACTILED_SCAN_OCTETS 85u
#define TACTILED_HELLO_OCTETS 144u
#define TACTILED_ACKNOWLEDGE_OCTETS 13u

/* Message types. */
#define TACTILED_SCAN 0x01u
#define TACTILED_HELLO 0x02u
#define TACTILED_ACKNOWLEDGE 0x03u
#define TACTILED_START 0x10u
#define TACTILED_STOP 0x11u
#define TACTILED_SET_RATE 0x12u
#define TACTILED_PING 0x13u
#define TACTILED_IDENTIFY 0x14u

/* Results in an acknowledge. */
#define TACTILED_OK 0u
#define TACTILED_UNKNOWN_COMMAND 1u
#define TACTILED_BAD_ARGUMENT 2u
#define TACTILED_WRONG_STATE 3u
#define TACTILED_BUSY 4u

/* Bits of tactiled_scan.flags. */
#define TACTILED_FIRST_AFTER_START 0x0001u
#define TACTILED_OVERRUN 0x0002u
#define TACTILED_REFERENCE_FAULT 0x0004u

/* ---- board to host ------------------------------------------------------------------------------- */

typedef struct {
    uint_least16_t sequence; /* +1 for each scan attempted, wraps at 65536 */
    uint_least32_t ticks_us; /* when the scan began, wraps at 2^32 */
    uint_least16_t flags;
    uint_least16_t counts[TACTILED_CHANNELS]; /* 0..4095 with 12 bits; channel = 4 * taxel + k */
} tactiled_scan;

typedef struct {
    uint_least16_t protocol_version;
    const char *firmware_version; /* printable ASCII; longer than 12 characters is cut */
    const char *board_serial;     /* 16 */
    const char *array_id;         /* 24 */
    uint_least16_t boot_count;
    uint_least16_t streaming; /* 1 while scans are being sent, else 0 */
    uint_least32_t ticks_us;
    uint_least32_t rate_millihertz;
    uint_least16_t adc_bits;
    uint_least16_t adc_reference_millivolts;
    uint_least16_t channel_offset_us[TACTILED_CHANNELS];
} tactiled_hello;

typedef struct {
    uint_least16_t token;   /* of the command that is answered */
    uint_least16_t command; /* its message type */
    uint_least16_t result;
    uint_least32_t ticks_us;
} tactiled_acknowledge;

/* Each writes one frame to `out`, which has room for the octets named above, and returns how many. */
size_t tactiled_encode_scan(const tactiled_scan *scan, tactiled_octet *out);
size_t tactiled_encode_hello(const tactiled_hello *hello, tactiled_octet *out);
size_t tactiled_encode_acknowledge(const tactiled_acknowledge *acknowledge, tactiled_octet *out);

/* Largest rate that leaves a twentieth of the line free, as set_rate must check it (8N1: ten bits an octet);
 * the macro is for constants. 32 bits suffice up to 45 Mbaud. */
#define TACTILED_LARGEST_RATE_MILLIHERTZ(baud) ((baud) / 10u * 950u / TACTILED_SCAN_OCTETS)
uint_least32_t tactiled_largest_rate_millihertz(uint_least32_t baud);

/* What the encoders are made of: begin, put body octets in order, end. */
typedef struct {
    tactiled_octet *out;
    size_t at;      /* next octet to write */
    size_t code_at; /* where the code of the open COBS block belongs */
    uint_least16_t crc;
} tactiled_writer;

void tactiled_begin(tactiled_writer *writer, tactiled_octet *out);
void tactiled_put(tactiled_writer *writer, uint_least16_t octet);
size_t tactiled_end(tactiled_writer *writer);

/* ---- host to board ------------------------------------------------------------------------------- */

/* The longest command of version 1 is 10 octets before its 0x00; longer ones of later versions, up to
 * this, are still answered with unknown_command. */
#define TACTILED_RECEIVER_OCTETS 32u

typedef struct {
    tactiled_octet held[TACTILED_RECEIVER_OCTETS];
    size_t n; /* octets held; TACTILED_RECEIVER_OCTETS + 1 once they did not fit */
} tactiled_receiver; /* all zero to begin with */

typedef struct {
    uint_least16_t type;
    uint_least16_t token;
    uint_least32_t rate_millihertz; /* of set_rate, else 0 */
} tactiled_command;

typedef enum {
    TACTILED_RECEIVED_NOTHING, /* no frame ends here */
    TACTILED_RECEIVED_COMMAND, /* *command is filled */
    TACTILED_RECEIVED_UNKNOWN, /* intact, but type or length is not ours: answer unknown_command */
    TACTILED_RECEIVED_CORRUPT  /* ignore it, and count it */
} tactiled_received;

/* Takes one octet from the line. */
tactiled_received tactiled_receive(tactiled_receiver *receiver, uint_least16_t octet,
                                   tactiled_command *command);

#ifdef __cplusplus
}
#endif

#endif
