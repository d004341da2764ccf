/* Port of the example firmware to the Cortex-M3 of Arm's MPS2 board with FPGA image AN385, as qemu emulates it.
 *
 * Register names and addresses: Arm DAI 0385 (memory map) and DDI 0479 (CMSDK peripherals).
 */
#include "firmware.h"

#define REGISTER(address) (*(volatile uint32_t *)(address))

#define CLOCK_HZ 25000000u

#define TIMER_CONTROL REGISTER(0x40000000u)
#define TIMER_VALUE REGISTER(0x40000004u)
#define TIMER_RELOAD REGISTER(0x40000008u)
#define TIMER_CLEAR REGISTER(0x4000000Cu)
#define TIMER_ENABLE 0x1u
#define TIMER_INTERRUPT 0x8u

#define UART_DATA REGISTER(0x40004000u)
#define UART_STATE REGISTER(0x40004004u)
#define UART_CONTROL REGISTER(0x40004008u)
#define UART_CLEAR REGISTER(0x4000400Cu)
#define UART_DIVISOR REGISTER(0x40004010u)
#define UART_TRANSMIT_FULL 0x1u /* of UART_STATE */
#define UART_RECEIVE_FULL 0x2u
#define UART_TRANSMIT_DONE 0x1u /* of UART_CLEAR */
#define UART_RECEIVED 0x2u
#define UART_ENABLE 0x3u /* of UART_CONTROL: both directions */
#define UART_TRANSMIT_INTERRUPT 0x4u
#define UART_RECEIVE_INTERRUPT 0x8u

#define WATCHDOG_LOAD REGISTER(0x40008000u)
#define WATCHDOG_CONTROL REGISTER(0x40008008u)
#define WATCHDOG_CLEAR REGISTER(0x4000800Cu)
#define WATCHDOG_RESETS 0x3u /* interrupt after one period without food, reset after the second */
#define WATCHDOG_COUNTS CLOCK_HZ /* 1 s */

#define FPGA_COUNTER REGISTER(0x40028018u)
#define FPGA_PRESCALE REGISTER(0x4002801Cu)

#define SYSTICK_CONTROL REGISTER(0xE000E010u)
#define SYSTICK_RELOAD REGISTER(0xE000E014u)
#define SYSTICK_RUNS 0x7u /* enabled, with interrupt, on the clock of the processor */
#define NVIC_ENABLE REGISTER(0xE000E100u)
#define INTERRUPTS ((1u << 0) | (1u << 1) | (1u << 8)) /* UART received, UART sent, timer */

/* ---- clock, timer, watchdog -------------------------------------------------------------------------- */

uint_least32_t port_ticks_us(void)
{
    return FPGA_COUNTER;
}

void port_timer_start(uint_least32_t period_us)
{
    TIMER_CONTROL = 0u;
    TIMER_RELOAD = period_us * (CLOCK_HZ / 1000000u) - 1u; /* 32 bits suffice for 171 s */
    TIMER_VALUE = TIMER_RELOAD;
    TIMER_CLEAR = 1u;
    TIMER_CONTROL = TIMER_ENABLE | TIMER_INTERRUPT;
}

void port_timer_stop(void)
{
    TIMER_CONTROL = 0u;
    TIMER_CLEAR = 1u;
}

static void timer_interrupt(void)
{
    TIMER_CLEAR = 1u;
    firmware_timer_fired();
}

void port_feed_watchdog(void)
{
    WATCHDOG_CLEAR = 1u;
}

void port_lock(void)
{
    __asm volatile("cpsid i" ::: "memory");
}

void port_unlock(void)
{
    __asm volatile("cpsie i" ::: "memory");
}

void port_wait(void)
{
    __asm volatile("wfi" ::: "memory");
}

/* ---- converter --------------------------------------------------------------------------------------- */

/* The board has no converter. A reading says its input, and differs from that of the scan before. */
uint_least16_t port_convert(uint_least16_t input)
{
    static uint_least16_t n;
    n = (uint_least16_t)(n * 25173u + 13849u); /* a small generator of noise, 16 counts wide */
    return (uint_least16_t)(1024u + 32u * input + (n >> 12));
}

int port_reference_good(void)
{
    return 1;
}

/* ---- UART -------------------------------------------------------------------------------------------- */

/* The emulated UART sends an octet in no time. It is given the next one only when the line is over with those
 * before, so that frames take their time, queues fill, and a reset cuts frames off. A real UART needs no such
 * wait, nor the interrupt each millisecond that ends it. */
#define OCTET_US 87u /* ten bits at 115200 baud */
static uint32_t line_free_us;

static void send_octets(void)
{
    uint32_t now_us = port_ticks_us();
    uint_least16_t octet;
    while (now_us - line_free_us < 0x80000000u && !(UART_STATE & UART_TRANSMIT_FULL)) {
        if (!firmware_next_octet(&octet)) {
            line_free_us = now_us;
            return;
        }
        UART_DATA = octet;
        line_free_us += OCTET_US;
    }
}

void port_transmit(void)
{
    port_lock(); /* the interrupts send too */
    send_octets();
    port_unlock();
}

static void sent_interrupt(void)
{
    UART_CLEAR = UART_TRANSMIT_DONE;
    send_octets();
}

static void received_interrupt(void)
{
    UART_CLEAR = UART_RECEIVED;
    while (UART_STATE & UART_RECEIVE_FULL) {
        firmware_octet_received((uint_least16_t)UART_DATA);
    }
}

/* ---- reset ------------------------------------------------------------------------------------------- */

/* From mps2_an385.ld. */
extern uint32_t data_image[], data_begin[], data_end[], bss_end[], stack_end[];

/* Survives a reset, because nothing clears its section; after power-up it is whatever the memory holds. A
 * board of yours keeps it in flash: memory often comes up with the same content each time. */
static uint32_t boots __attribute__((section(".noinit")));

static void reset(void)
{
    const uint32_t *from = data_image;
    uint32_t *to = data_begin;
    while (to < data_end) {
        *to++ = *from++;
    }
    while (to < bss_end) {
        *to++ = 0u;
    }
    boots++;
    FPGA_PRESCALE = CLOCK_HZ / 1000000u - 1u;
    FPGA_COUNTER = 0u;
    WATCHDOG_LOAD = WATCHDOG_COUNTS;
    WATCHDOG_CONTROL = WATCHDOG_RESETS;
    UART_DIVISOR = CLOCK_HZ / BAUD;
    UART_CONTROL = UART_ENABLE | UART_TRANSMIT_INTERRUPT | UART_RECEIVE_INTERRUPT;
    SYSTICK_RELOAD = CLOCK_HZ / 1000u - 1u;
    SYSTICK_CONTROL = SYSTICK_RUNS;
    NVIC_ENABLE = INTERRUPTS;
    firmware_run((uint_least16_t)boots);
}

/* A fault waits for the watchdog. */
static void fault(void)
{
    for (;;) {
    }
}

typedef void (*vector)(void);
__attribute__((section(".vectors"), used)) static const vector VECTORS[16 + 9] = {
    (vector)stack_end, reset, fault, fault, fault, fault, fault,
    [11] = fault, /* supervisor call */
    [14] = fault,
    [15] = send_octets,
    [16 + 0] = received_interrupt,
    [16 + 1] = sent_interrupt,
    [16 + 8] = timer_interrupt,
};
