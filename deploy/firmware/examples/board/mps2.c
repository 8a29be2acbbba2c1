/* mps2.c: the board on an Arm MPS2 with a Cortex-M4, which qemu emulates; the daemon is at its first UART.
 *
 *     qemu-system-arm -M mps2-an386 -display none -monitor none -serial pty \
 *         -semihosting-config enable=on,target=native,arg=board,arg=demo,arg=60,arg=1,arg=0 -kernel board-m4.elf
 *
 * arg: CRAFT, SECONDS, SPEED, NOISE as in posix.c, then the key itself in hex and the counter.  qemu says which pseudo-terminal it made.
 */
#include <stdlib.h>

#include "board.h"
#include "port.h"

#define CLOCK_HZ 25000000
#define REGISTER(address) (*(volatile uint32_t *)(address))
#define UART_DATA REGISTER(0x40004000)
#define UART_STATE REGISTER(0x40004004) /* bit 0: nothing more can be sent; bit 1: a byte is there */
#define UART_CONTROL REGISTER(0x40004008)
#define UART_INTERRUPT REGISTER(0x4000400C) /* a 1 clears; bit 1: a byte has come */
#define UART_DIVIDER REGISTER(0x40004010)
#define TIMER_CONTROL REGISTER(0x40000000)
#define TIMER_VALUE REGISTER(0x40000004)
#define TIMER_RELOAD REGISTER(0x40000008)
#define SYSTICK_CONTROL REGISTER(0xE000E010)
#define SYSTICK_RELOAD REGISTER(0xE000E014)
#define NVIC_ENABLE REGISTER(0xE000E100)
#define NVIC_CLEAR REGISTER(0xE000E280)
#define SYSTEM_INTERRUPT REGISTER(0xE000ED04) /* bit 25 clears the pending SysTick */
#define UART_RECEIVE_IRQ 1u

extern uint32_t __stack;
extern void _mainCRTStartup(void); /* newlib's: clears memory, asks for the arguments, calls main */

void reset(void);
void reset(void) { _mainCRTStartup(); }

static void fault(void) { abort(); }

__attribute__((section(".vectors"), used)) static const struct {
    uint32_t *stack;
    void (*handlers[6])(void);
} vectors = {&__stack, {reset, fault, fault, fault, fault, fault}};

int port_read(uint8_t *byte) {
    if ((UART_STATE & 2u) == 0) return 0;
    *byte = (uint8_t)UART_DATA;
    return 1;
}

void port_write(const uint8_t *bytes, size_t size) {
    while (size-- > 0) {
        while (UART_STATE & 1u) {
        }
        UART_DATA = *bytes++;
    }
}

/* The timer counts down and wraps after 171 s; it is read far more often than that. */
int64_t port_time_ns(void) {
    static uint32_t last = 0xFFFFFFFFu;
    static int64_t ticks;
    const uint32_t now = TIMER_VALUE;
    ticks += (int64_t)(uint32_t)(last - now);
    last = now;
    return ticks * (1000000000 / CLOCK_HZ);
}

/* Interrupts stay masked: a pending one, of the UART or of the millisecond, ends the sleep and is cleared here. */
void port_idle(void) {
    __asm volatile("wfi");
    UART_INTERRUPT = 2;
    NVIC_CLEAR = UART_RECEIVE_IRQ;
    SYSTEM_INTERRUPT = 1u << 25;
}

int main(int argc, char **argv) {
    static board_options options;
    __asm volatile("cpsid i");
    UART_DIVIDER = CLOCK_HZ / 115200;
    UART_CONTROL = 1 + 2 + 8; /* send, receive, tell of a byte received */
    NVIC_ENABLE = UART_RECEIVE_IRQ;
    TIMER_RELOAD = TIMER_VALUE = 0xFFFFFFFFu;
    TIMER_CONTROL = 1;
    SYSTICK_RELOAD = CLOCK_HZ / 1000 - 1;
    SYSTICK_CONTROL = 7; /* on, pending each millisecond, by the processor's clock */
    if (!board_read(&options, argc - 1, argv + 1)) return 2;
    if (argc > 6) {
        options.key_size = board_key(argv[5], options.key);
        if (!board_counter(argv[6], &options.counter)) return 2;
    }
    return board_run(&options);
}
