#include "tactiled_board.h"

/* CRC-16/IBM-3740 (also known as CCITT-FALSE): width 16, poly 0x1021, init 0xFFFF, no reflection,
 * xorout 0, check value 0x29B1 over "123456789". Bit by bit, without a table: 81 octets x 8 bits x
 * some 10 cycles is 0.05 ms of a C28x at 150 MHz, of the 10 ms between scans. */
static uint_least16_t crc_next(uint_least16_t crc, uint_least16_t octet)
{
    int bit;
    crc = (uint_least16_t)((crc ^ ((octet & 0xFFu) << 8)) & 0xFFFFu);
    for (bit = 0; bit < 8; bit++) {
        uint_least16_t carry = (uint_least16_t)(crc & 0x8000u);
        crc = (uint_least16_t)(((uint_least32_t)crc << 1) & 0xFFFFu);
        if (carry) {
            crc = (uint_least16_t)(crc ^ 0x1021u);
        }
    }
    return crc;
}

/* ---- board to host ------------------------------------------------------------------------------- */

/* A COBS block is a code, 1 + the number of octets that follow it, and those octets, none of them zero.
 * Every block but the last stands for its octets and one zero, unless its code is 255: 254 octets, no
 * zero. The code is known only when the block is full, so its place is left free and filled later. */
static void close_block(tactiled_writer *writer)
{
    writer->out[writer->code_at] = (tactiled_octet)(writer->at - writer->code_at);
    writer->code_at = writer->at++;
}

static void stuff(tactiled_writer *writer, uint_least16_t octet)
{
    octet = (uint_least16_t)(octet & 0xFFu);
    if (writer->at - writer->code_at == 255u) {
        close_block(writer); /* only now: a full block at the end of a frame opens no other */
    }
    if (octet == 0u) {
        close_block(writer);
    } else {
        writer->out[writer->at++] = (tactiled_octet)octet;
    }
}

void tactiled_begin(tactiled_writer *writer, tactiled_octet *out)
{
    writer->out = out;
    writer->at = 1u;
    writer->code_at = 0u;
    writer->crc = 0xFFFFu;
}

void tactiled_put(tactiled_writer *writer, uint_least16_t octet)
{
    writer->crc = crc_next(writer->crc, octet);
    stuff(writer, octet);
}

size_t tactiled_end(tactiled_writer *writer)
{
    uint_least16_t crc = writer->crc;
    stuff(writer, crc);
    stuff(writer, (uint_least16_t)(crc >> 8));
    writer->out[writer->code_at] = (tactiled_octet)(writer->at - writer->code_at);
    writer->out[writer->at++] = 0u;
    return writer->at;
}

static void put_u16(tactiled_writer *writer, uint_least16_t value)
{
    tactiled_put(writer, value);
    tactiled_put(writer, (uint_least16_t)(value >> 8));
}

static void put_u32(tactiled_writer *writer, uint_least32_t value)
{
    put_u16(writer, (uint_least16_t)(value & 0xFFFFu));
    put_u16(writer, (uint_least16_t)((value >> 16) & 0xFFFFu));
}

static void put_text(tactiled_writer *writer, const char *text, unsigned size)
{
    while (size-- > 0u) {
        tactiled_put(writer, (uint_least16_t)*text);
        if (*text != '\0') {
            text++;
        }
    }
}

size_t tactiled_encode_scan(const tactiled_scan *scan, tactiled_octet *out)
{
    tactiled_writer writer;
    unsigned channel;
    tactiled_begin(&writer, out);
    tactiled_put(&writer, TACTILED_SCAN);
    put_u16(&writer, scan->sequence);
    put_u32(&writer, scan->ticks_us);
    put_u16(&writer, scan->flags);
    for (channel = 0; channel < TACTILED_CHANNELS; channel++) {
        put_u16(&writer, scan->counts[channel]);
    }
    return tactiled_end(&writer);
}

size_t tactiled_encode_hello(const tactiled_hello *hello, tactiled_octet *out)
{
    tactiled_writer writer;
    unsigned channel;
    tactiled_begin(&writer, out);
    tactiled_put(&writer, TACTILED_HELLO);
    tactiled_put(&writer, hello->protocol_version);
    put_text(&writer, hello->firmware_version, 12u);
    put_text(&writer, hello->board_serial, 16u);
    put_text(&writer, hello->array_id, 24u);
    put_u16(&writer, hello->boot_count);
    tactiled_put(&writer, hello->streaming);
    put_u32(&writer, hello->ticks_us);
    put_u32(&writer, hello->rate_millihertz);
    tactiled_put(&writer, hello->adc_bits);
    put_u16(&writer, hello->adc_reference_millivolts);
    for (channel = 0; channel < TACTILED_CHANNELS; channel++) {
        put_u16(&writer, hello->channel_offset_us[channel]);
    }
    return tactiled_end(&writer);
}

size_t tactiled_encode_acknowledge(const tactiled_acknowledge *acknowledge, tactiled_octet *out)
{
    tactiled_writer writer;
    tactiled_begin(&writer, out);
    tactiled_put(&writer, TACTILED_ACKNOWLEDGE);
    put_u16(&writer, acknowledge->token);
    tactiled_put(&writer, acknowledge->command);
    tactiled_put(&writer, acknowledge->result);
    put_u32(&writer, acknowledge->ticks_us);
    return tactiled_end(&writer);
}

uint_least32_t tactiled_largest_rate_millihertz(uint_least32_t baud)
{
    return TACTILED_LARGEST_RATE_MILLIHERTZ(baud);
}

/* ---- host to board ------------------------------------------------------------------------------- */

/* Undoes COBS in place; returns how many octets remain, or 0 when this is not COBS. */
static size_t unstuff(tactiled_octet *held, size_t n)
{
    size_t from = 0u, to = 0u;
    while (from < n) {
        size_t code = held[from++];
        size_t run = code - 1u; /* no zero is ever held, so code >= 1 */
        if (run > n - from) {
            return 0u;
        }
        while (run-- > 0u) {
            held[to++] = held[from++];
        }
        if (code < 255u && from < n) {
            held[to++] = 0u;
        }
    }
    return to;
}

static uint_least16_t get_u16(const tactiled_octet *held)
{
    return (uint_least16_t)(held[0] | ((uint_least32_t)held[1] << 8));
}

static tactiled_received close_frame(tactiled_octet *held, size_t n, tactiled_command *command)
{
    uint_least16_t crc = 0xFFFFu;
    size_t i;
    n = unstuff(held, n);
    if (n < 5u) { /* type, token and checksum at least */
        return TACTILED_RECEIVED_CORRUPT;
    }
    n -= 2u;
    for (i = 0u; i < n; i++) {
        crc = crc_next(crc, (uint_least16_t)held[i]);
    }
    if (crc != get_u16(held + n)) {
        return TACTILED_RECEIVED_CORRUPT;
    }
    command->type = (uint_least16_t)held[0];
    command->token = get_u16(held + 1);
    command->rate_millihertz = 0u;
    switch (command->type) {
    case TACTILED_SET_RATE:
        if (n != 7u) {
            return TACTILED_RECEIVED_UNKNOWN;
        }
        command->rate_millihertz = get_u16(held + 3) | ((uint_least32_t)get_u16(held + 5) << 16);
        return TACTILED_RECEIVED_COMMAND;
    case TACTILED_START:
    case TACTILED_STOP:
    case TACTILED_PING:
    case TACTILED_IDENTIFY:
        return n == 3u ? TACTILED_RECEIVED_COMMAND : TACTILED_RECEIVED_UNKNOWN;
    default:
        return TACTILED_RECEIVED_UNKNOWN;
    }
}

tactiled_received tactiled_receive(tactiled_receiver *receiver, uint_least16_t octet,
                                   tactiled_command *command)
{
    size_t n = receiver->n;
    octet = (uint_least16_t)(octet & 0xFFu);
    if (octet != 0u) {
        if (n < TACTILED_RECEIVER_OCTETS) {
            receiver->held[receiver->n++] = (tactiled_octet)octet;
        } else {
            receiver->n = TACTILED_RECEIVER_OCTETS + 1u;
        }
        return TACTILED_RECEIVED_NOTHING;
    }
    receiver->n = 0u;
    if (n == 0u) { /* two delimiters in a row: the host cleared the line */
        return TACTILED_RECEIVED_NOTHING;
    }
    return n > TACTILED_RECEIVER_OCTETS ? TACTILED_RECEIVED_CORRUPT
                                        : close_frame(receiver->held, n, command);
}
