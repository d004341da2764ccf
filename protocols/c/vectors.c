/* Golden vectors of the board protocol, for a host with a C compiler:
 *
 *     cc -std=c99 -o vectors vectors.c tactiled_board.c && ./vectors > ../vectors/board-v1.txt
 *
 * Each line is "request => answer". Without arguments it answers the requests listed below; with the
 * argument "-" it answers those on its standard input, one a line, which is how the tests compare
 * thousands of random frames. Requests:
 *
 *     scan SEQUENCE TICKS FLAGS COUNT*36
 *     hello PROTOCOL "FIRMWARE" "SERIAL" "ARRAY" BOOTS STREAMING TICKS MILLIHERTZ BITS MILLIVOLTS OFFSET*36
 *     acknowledge TOKEN COMMAND RESULT TICKS
 *     body OCTET*       any message body, to be given its checksum, COBS and delimiter
 *     receive WORD*     words from the line to the board, of which the lower eight bits count
 *     rate BAUD         largest rate in millihertz
 *
 * Numbers are decimal, or hexadecimal with 0x. Frames are answered in hexadecimal; "receive" with what
 * the board makes of it: "command TYPE TOKEN MILLIHERTZ", "unknown TYPE TOKEN" or "corrupt", each
 * followed by a semicolon.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tactiled_board.h"

#define LONGEST_LINE 65536
#define ROOM 8192

static const char *const GOLDEN[] = {
    /* the worked example of board.md */
    "scan 258 1000000 1 2048 2049 2050 2051 2052 2053 2054 2055 2056 2057 2058 2059 2060 2061 2062 2063 2064 "
    "2065 2066 2067 2068 2069 2070 2071 2072 2073 2074 2075 2076 2077 2078 2079 2080 2081 2082 2083",
    /* all zeros: the longest chain of COBS blocks */
    "scan 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0",
    /* every field full, the last before both wraps */
    "scan 65535 4294967295 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 "
    "65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 "
    "65535 65535 65535 65535 65535 65535",
    /* the largest reading of 12 bits, at each wrap of one field alone */
    "scan 65535 0 0 4095 4095 4095 4095 4095 4095 4095 4095 4095 4095 4095 4095 4095 4095 4095 4095 4095 4095 "
    "4095 4095 4095 4095 4095 4095 4095 4095 4095 4095 4095 4095 4095 4095 4095 4095 4095 4095",
    "scan 0 4294967295 6 1 0 256 255 1 0 256 255 1 0 256 255 1 0 256 255 1 0 256 255 1 0 256 255 1 0 256 "
    "255 1 0 256 255 1 0 256 255",
    "hello 1 \"1.0.0\" \"TB-0001\" \"wang2019-3x3\" 3 0 2500000 100000 12 3000 0 80 160 240 320 400 480 560 640 "
    "720 800 880 960 1040 1120 1200 1280 1360 1440 1520 1600 1680 1760 1840 1920 2000 2080 2160 2240 2320 2400 "
    "2480 2560 2640 2720 2800",
    /* empty texts */
    "hello 0 \"\" \"\" \"\" 0 0 0 1 1 1 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0",
    /* texts that fill their fields to the last octet, so that no NUL ends them */
    "hello 255 \"123456789abc\" \"123456789abcdefg\" \"123456789abcdefghijklmno\" 65535 1 4294967295 4294967295 "
    "32 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 "
    "65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 65535 "
    "65535 65535 65535",
    "acknowledge 1 0x10 0 1000000",
    "acknowledge 65535 0x12 2 4294967295",
    "acknowledge 0 0x7f 1 0",
    /* the check value of the checksum: 0xB1 0x29 follows the nine octets */
    "body 0x31 0x32 0x33 0x34 0x35 0x36 0x37 0x38 0x39",
    /* start, stop, set_rate 100 Hz, ping, identify with tokens 1 to 5 */
    "body 0x10 1 0",
    "body 0x11 2 0",
    "body 0x12 3 0 0xa0 0x86 0x01 0",
    "body 0x13 4 0",
    "body 0x14 5 0",
    /* what the board makes of start: intact, damaged, with rubbish above the octets */
    "receive 0x03 0x10 0x01 0x03 0xce 0xbc 0x00",
    "receive 0x03 0x10 0x01 0x03 0xce 0xbd 0x00",
    "receive 0xff03 0xab10 0x1001 0x8003 0x7fce 0x01bc 0xaa00",
    /* set_rate behind an empty frame; then a type that version 1 does not know */
    "receive 0x00 0x00 0x03 0x12 0x03 0x04 0xa0 0x86 0x01 0x03 0x0b 0x38 0x00",
    "receive 0x03 0x7f 0x05 0x03 0x50 0xc7 0x00",
    "rate 115200",
    "rate 921600",
};

static tactiled_octet frame[ROOM];

static void fail(const char *what)
{
    fprintf(stderr, "vectors: %s\n", what);
    exit(2);
}

static const char *skip(const char *at)
{
    while (*at == ' ') {
        at++;
    }
    return at;
}

static unsigned long number(const char **at)
{
    char *end;
    const char *from = skip(*at);
    unsigned long value = strtoul(from, &end, 0);
    if (end == from) {
        fail("a number is missing");
    }
    *at = end;
    return value;
}

static void nothing_more(const char *at)
{
    if (*skip(at) != '\0') {
        fail("a request has more than its message");
    }
}

static void text(const char **at, char *into, size_t room)
{
    const char *from = skip(*at);
    const char *end = *from == '"' ? strchr(from + 1, '"') : NULL;
    if (end == NULL || (size_t)(end - from) > room) {
        fail("a quoted text is missing or too long");
    }
    memcpy(into, from + 1, (size_t)(end - from - 1));
    into[end - from - 1] = '\0';
    *at = end + 1;
}

static void print_frame(size_t n)
{
    size_t i;
    for (i = 0; i < n; i++) {
        if (((unsigned long)frame[i] & ~0xFFul) != 0ul) {
            fail("an octet has more than eight bits");
        }
        printf("%02x", (unsigned)frame[i]);
    }
}

static void answer_scan(const char *at)
{
    tactiled_scan scan;
    unsigned i;
    scan.sequence = (uint_least16_t)number(&at);
    scan.ticks_us = (uint_least32_t)number(&at);
    scan.flags = (uint_least16_t)number(&at);
    for (i = 0; i < TACTILED_CHANNELS; i++) {
        scan.counts[i] = (uint_least16_t)number(&at);
    }
    nothing_more(at);
    print_frame(tactiled_encode_scan(&scan, frame));
}

static void answer_hello(const char *at)
{
    tactiled_hello hello;
    char firmware[65], serial[65], array[65];
    unsigned i;
    hello.protocol_version = (uint_least16_t)number(&at);
    text(&at, firmware, 64);
    text(&at, serial, 64);
    text(&at, array, 64);
    hello.firmware_version = firmware;
    hello.board_serial = serial;
    hello.array_id = array;
    hello.boot_count = (uint_least16_t)number(&at);
    hello.streaming = (uint_least16_t)number(&at);
    hello.ticks_us = (uint_least32_t)number(&at);
    hello.rate_millihertz = (uint_least32_t)number(&at);
    hello.adc_bits = (uint_least16_t)number(&at);
    hello.adc_reference_millivolts = (uint_least16_t)number(&at);
    for (i = 0; i < TACTILED_CHANNELS; i++) {
        hello.channel_offset_us[i] = (uint_least16_t)number(&at);
    }
    nothing_more(at);
    print_frame(tactiled_encode_hello(&hello, frame));
}

static void answer_acknowledge(const char *at)
{
    tactiled_acknowledge acknowledge;
    acknowledge.token = (uint_least16_t)number(&at);
    acknowledge.command = (uint_least16_t)number(&at);
    acknowledge.result = (uint_least16_t)number(&at);
    acknowledge.ticks_us = (uint_least32_t)number(&at);
    nothing_more(at);
    print_frame(tactiled_encode_acknowledge(&acknowledge, frame));
}

static void answer_body(const char *at)
{
    tactiled_writer writer;
    tactiled_begin(&writer, frame);
    for (at = skip(at); *at != '\0'; at = skip(at)) {
        if (writer.at > ROOM - 16) {
            fail("a body is too long");
        }
        tactiled_put(&writer, (uint_least16_t)number(&at));
    }
    print_frame(tactiled_end(&writer));
}

static void answer_receive(const char *at)
{
    tactiled_receiver receiver;
    tactiled_command command;
    memset(&receiver, 0, sizeof receiver);
    for (at = skip(at); *at != '\0'; at = skip(at)) {
        switch (tactiled_receive(&receiver, (uint_least16_t)number(&at), &command)) {
        case TACTILED_RECEIVED_COMMAND:
            printf("command 0x%02x %u %lu;", (unsigned)command.type, (unsigned)command.token,
                   (unsigned long)command.rate_millihertz);
            break;
        case TACTILED_RECEIVED_UNKNOWN:
            printf("unknown 0x%02x %u;", (unsigned)command.type, (unsigned)command.token);
            break;
        case TACTILED_RECEIVED_CORRUPT:
            printf("corrupt;");
            break;
        case TACTILED_RECEIVED_NOTHING:
            break;
        }
    }
}

static void answer(const char *request)
{
    static const struct {
        const char *name;
        void (*with)(const char *at);
    } VERBS[] = {{"scan ", answer_scan},         {"hello ", answer_hello}, {"acknowledge ", answer_acknowledge},
                 {"receive ", answer_receive}, {"body ", answer_body}};
    size_t i;
    printf("%s => ", request);
    for (i = 0; i < sizeof VERBS / sizeof VERBS[0]; i++) {
        if (strncmp(request, VERBS[i].name, strlen(VERBS[i].name)) == 0) {
            VERBS[i].with(request + strlen(VERBS[i].name));
            putchar('\n');
            return;
        }
    }
    if (strncmp(request, "rate ", 5) == 0) {
        const char *at = request + 5;
        printf("%lu\n", (unsigned long)tactiled_largest_rate_millihertz((uint_least32_t)number(&at)));
        return;
    }
    fail("no such request");
}

int main(int argc, char **argv)
{
    static char line[LONGEST_LINE];
    size_t i;
    if (argc > 1 && strcmp(argv[1], "-") == 0) {
        while (fgets(line, LONGEST_LINE, stdin) != NULL) {
            line[strcspn(line, "\n")] = '\0';
            answer(line);
        }
        return 0;
    }
    for (i = 0; i < sizeof GOLDEN / sizeof GOLDEN[0]; i++) {
        answer(GOLDEN[i]);
    }
    return 0;
}
