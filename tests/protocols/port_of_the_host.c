/* Port of the example firmware to a host, without waiting: its timer is FAST_PPM faster than its board clock.
 *
 * It starts the board, lets the timer fire 200 times, and prints the octets that the board sends.
 */
#include <stdio.h>
#include <stdlib.h>

#include "firmware.h"

#define FIRINGS 200

static double now_us, next_us, timer_us; /* timer_us: its period; 0 while it is stopped */
static int is_locked, firings;

uint_least32_t port_ticks_us(void)
{
    return (uint_least32_t)now_us;
}

void port_timer_start(uint_least32_t period_us)
{
    timer_us = (double)period_us * (1.0 - FAST_PPM * 1e-6);
    next_us = now_us + timer_us;
}

void port_timer_stop(void)
{
    timer_us = 0.0;
}

uint_least16_t port_convert(uint_least16_t input)
{
    if (is_locked) {
        abort(); /* the queues of the UART would overflow while all channels are sampled */
    }
    return input;
}

int port_reference_good(void)
{
    return 1;
}

void port_transmit(void)
{
    uint_least16_t octet;
    while (firmware_next_octet(&octet)) {
        putchar((int)octet);
    }
}

void port_lock(void)
{
    is_locked = 1;
}

void port_unlock(void)
{
    is_locked = 0;
}

void port_feed_watchdog(void) {}

void port_wait(void)
{
    now_us += 1000.0;
    if (timer_us > 0.0 && now_us >= next_us) {
        if (firings++ == FIRINGS) {
            exit(0);
        }
        now_us = next_us;
        next_us += timer_us;
        firmware_timer_fired();
    }
}

int main(void)
{
    static const uint_least16_t START[] = {0x03u, 0x10u, 0x01u, 0x03u, 0xCEu, 0xBCu, 0x00u};
    size_t i;
    for (i = 0u; i < sizeof START / sizeof *START; i++) {
        firmware_octet_received(START[i]);
    }
    firmware_run(1u);
}
