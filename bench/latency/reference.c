/* The least that any host has to do for a scan: read the tty, decode COBS, check the CRC, convert to volts,
 * filter every channel by five levels of an undecimated filter bank with 36 x (6, 16, 36, 76, 156) taps, and
 * send the result as one datagram on the loopback. No clock fit, no detector, no store, no recording.
 *
 *     reference TTY UDP_PORT
 *
 * A datagram is the sequence number (16 bits) and the five band energies (5 doubles), both little-endian as
 * they lie in memory.
 */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

enum { CHANNELS = 36, LEVELS = 5, LONGEST = 156, SCAN_OCTETS = 9 + 2 * CHANNELS };

static const int lengths[LEVELS] = {6, 16, 36, 76, 156};
static double taps[LEVELS][LONGEST];
static double ring[LONGEST][CHANNELS];
static unsigned newest;

static uint16_t crc16(const uint8_t *octets, size_t n)
{
    uint16_t crc = 0xFFFF;
    for (size_t i = 0; i < n; i++) {
        crc ^= (uint16_t)(octets[i] << 8);
        for (int bit = 0; bit < 8; bit++)
            crc = (uint16_t)(crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1);
    }
    return crc;
}

/* Returns the decoded length, or 0 where this is no COBS. */
static size_t unstuff(const uint8_t *in, size_t n, uint8_t *out)
{
    size_t at = 0, size = 0;
    while (at < n) {
        unsigned code = in[at++];
        if (code == 0 || at + code - 1 > n)
            return 0;
        memcpy(out + size, in + at, code - 1);
        size += code - 1;
        at += code - 1;
        if (code < 255 && at < n)
            out[size++] = 0;
    }
    return size;
}

static void handle(const uint8_t *frame, size_t n, int out, const struct sockaddr_in *to)
{
    uint8_t plain[512], message[2 + LEVELS * sizeof(double)];
    double energy[LEVELS] = {0};
    size_t size = n < sizeof plain ? unstuff(frame, n, plain) : 0;
    if (size != SCAN_OCTETS + 2 || plain[0] != 1)
        return;
    if (crc16(plain, size - 2) != (uint16_t)(plain[size - 2] | plain[size - 1] << 8))
        return;
    newest = (newest + 1) % LONGEST;
    for (int c = 0; c < CHANNELS; c++)
        ring[newest][c] = (plain[9 + 2 * c] | plain[10 + 2 * c] << 8) * (3.0 / 4096);
    for (int level = 0; level < LEVELS; level++) {
        double sum[CHANNELS] = {0};
        for (int k = 0; k < lengths[level]; k++) {
            const double *scan = ring[(newest + LONGEST - (unsigned)k) % LONGEST];
            for (int c = 0; c < CHANNELS; c++)
                sum[c] += taps[level][k] * scan[c];
        }
        for (int c = 0; c < CHANNELS; c++)
            energy[level] += sum[c] * sum[c];
    }
    memcpy(message, plain + 1, 2);
    memcpy(message + 2, energy, sizeof energy);
    sendto(out, message, sizeof message, 0, (const struct sockaddr *)to, sizeof *to);
}

int main(int argc, char **argv)
{
    struct sockaddr_in to = {.sin_family = AF_INET};
    struct termios mode;
    uint8_t bytes[4096], frame[512];
    size_t held = 0;
    ssize_t n;
    if (argc != 3)
        return 2;
    int tty = open(argv[1], O_RDWR | O_NOCTTY), out = socket(AF_INET, SOCK_DGRAM, 0);
    if (tty < 0 || out < 0 || tcgetattr(tty, &mode) != 0) {
        perror(argv[1]);
        return 1;
    }
    cfmakeraw(&mode);
    tcsetattr(tty, TCSANOW, &mode);
    to.sin_port = htons((uint16_t)atoi(argv[2]));
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    for (int level = 0; level < LEVELS; level++)
        for (int k = 0; k < lengths[level]; k++) /* any taps cost the same; these sum to zero */
            taps[level][k] = (k % 2 ? -1.0 : 1.0) / lengths[level];
    puts("ready");
    fflush(stdout);
    while ((n = read(tty, bytes, sizeof bytes)) > 0) {
        for (ssize_t i = 0; i < n; i++) {
            if (bytes[i] != 0) {
                if (held < sizeof frame)
                    frame[held++] = bytes[i];
                continue;
            }
            if (held > 0)
                handle(frame, held, out, &to);
            held = 0;
        }
    }
    return 0;
}
