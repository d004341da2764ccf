/* An example firmware: what it needs from the microcontroller (port_...), and what the interrupts of the
 * microcontroller call (firmware_...). bring-up.md is the guide; mps2_an385.c is a port.
 */
#ifndef TACTILED_EXAMPLE_FIRMWARE_H
#define TACTILED_EXAMPLE_FIRMWARE_H

#include <stdint.h>

#include "../tactiled_board.h"

#ifdef __cplusplus
extern "C" {
#endif

#define BAUD 115200u /* of the UART */

/* ---- the port implements ------------------------------------------------------------------------- */

/* Board clock in microseconds: 0 at boot, never stops, wraps at 2^32. */
uint_least32_t port_ticks_us(void);

/* Calls firmware_timer_fired each period_us, first after one period; a running timer begins anew. Timer and
 * port_ticks_us count the same clock: with two, the stamps would drift apart from the scans. */
void port_timer_start(uint_least32_t period_us);
void port_timer_stop(void);

/* Switches the multiplexer to one input and converts it: 0 to 4095, right-justified. */
uint_least16_t port_convert(uint_least16_t input);

/* 1 while the reference voltage of the converter is in range, else 0. */
int port_reference_good(void);

/* Begins to call firmware_next_octet from the interrupt that sends, until that returns 0. */
void port_transmit(void);

/* Keeps the interrupts away from what they share with the main loop. Calls are never nested. */
void port_lock(void);
void port_unlock(void);

void port_feed_watchdog(void);

/* Sleeps until the next interrupt, for a millisecond at most; may return at once. */
void port_wait(void);

/* ---- the port calls ------------------------------------------------------------------------------ */

/* From reset, with all interrupts set up; never returns. */
void firmware_run(uint_least16_t boot_count);

/* From interrupts. Those of the UART must be able to interrupt that of the timer, which samples all channels:
 * 36 of 80 us are 33 octets at 115200 baud. */
void firmware_timer_fired(void);
void firmware_octet_received(uint_least16_t octet);
int firmware_next_octet(uint_least16_t *octet); /* 0: nothing to send */

/* What went wrong since boot, for your debugger. */
typedef struct {
    uint_least32_t scans_missed;   /* all buffers were full, or an interrupt came a period late */
    uint_least32_t frames_dropped; /* the transmit queue was full */
    uint_least32_t frames_corrupt; /* from the host */
    uint_least32_t octets_dropped; /* from the host: the receive queue was full */
} firmware_faults_t;
extern volatile firmware_faults_t firmware_faults;

#ifdef __cplusplus
}
#endif

#endif
