/*
 * Runs a firmware for the ATmega328P under simavr, cycle by cycle, with the pulses of an ADXL202 on pins 2 and 3.
 *
 *     run_firmware ELF SECONDS [PTY]
 *
 * Orders are read from standard input, one a line, before the run and during it:
 *
 *     period CYCLES x CYCLES y CYCLES skew CYCLES centred 0|1
 *
 * The pulse of y begins `skew` cycles after that of x (rising), or has its centre so much later (centred). What the
 * firmware sends is written to standard output, each byte as it leaves the UART, or with PTY to a pseudo-terminal whose
 * name is the first line on standard output; then standard input is read while it runs, and its end ends the run.
 * At the end one line on standard error says how many cycles were run.
 */

#define _GNU_SOURCE
#include <fcntl.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include <avr_ioport.h>
#include <avr_uart.h>
#include <sim_avr.h>
#include <sim_cycle_timers.h>
#include <sim_elf.h>

struct pulses {
    int64_t period, high[2], skew;
    int centred;
};

static struct pulses now, next;
static avr_irq_t *pin[2];
static int sink = STDOUT_FILENO;    /* of what the firmware sends */
static int held = -1;               /* the reader's end of a pseudo-terminal */

/* Edges of one period, counted from its beginning. */
static int64_t rise(const struct pulses *p, int axis)
{
    int64_t late = axis ? p->skew : 0;
    return p->centred ? (p->period - p->high[axis]) / 2 + late : late;
}


/* Let something happen at a cycle; a timer is called late where an instruction was under way, so delays would add up. */
static void at(avr_t *avr, avr_cycle_count_t cycle, avr_cycle_timer_t what, void *which)
{
    avr_cycle_timer_register(avr, cycle > avr->cycle ? cycle - avr->cycle : 0, what, which);
}

static avr_cycle_count_t down(avr_t *avr, avr_cycle_count_t when, void *which)
{
    avr_raise_irq(pin[(intptr_t)which], 0);
    return 0;
}

static avr_cycle_count_t up(avr_t *avr, avr_cycle_count_t when, void *which)
{
    intptr_t axis = (intptr_t)which;

    avr_raise_irq(pin[axis], 1);
    at(avr, when + now.high[axis], down, which);
    return 0;
}

/* The beginning of a period: both rises are within it. */
static avr_cycle_count_t period(avr_t *avr, avr_cycle_count_t when, void *unused)
{
    now = next;
    for (intptr_t axis = 0; axis < 2; axis++) {
        int64_t delay = rise(&now, axis);

        if (!now.high[axis])
            continue;
        if (delay <= 0)
            up(avr, when, (void *)axis);
        else
            at(avr, when + delay, up, (void *)axis);
    }
    return when + now.period;
}

/*
 * Sleep takes no time here, and as many cycles as there are until the next event: simavr adds one more, which an event
 * of the cycle behind would not have to wait for, so that two edges a cycle apart would be seen at once.
 */
static void slept(avr_t *avr, avr_cycle_count_t how_long)
{
    if (how_long)
        avr->cycle--;
}

/* What nobody reads is left out, sentence by sentence: a terminal that is full would stop the processor. */
static int left_out(char byte)
{
    static int dropping;
    int waiting = 0;

    if (byte == '$')
        dropping = held >= 0 && !ioctl(held, FIONREAD, &waiting) && waiting > 1000;
    return dropping;
}

static void sent(struct avr_irq_t *irq, uint32_t value, void *unused)
{
    char byte = value;

    if (left_out(byte))
        return;
    if (write(sink, &byte, 1) != 1)
        exit(0);
}

static int order(char *line)
{
    struct pulses p = next;

    if (sscanf(line, "period %ld x %ld y %ld skew %ld centred %d", &p.period, &p.high[0], &p.high[1], &p.skew,
               &p.centred) != 5)
        return 0;
    next = p;
    return 1;
}

int main(int argc, char **argv)
{
    elf_firmware_t firmware = {};
    char line[200];
    uint32_t flags = 0;
    double seconds = atof(argv[2]);
    int pty = argc > 3;
    avr_t *avr;

    if (elf_read_firmware(argv[1], &firmware))
        return 1;
    avr = avr_make_mcu_by_name("atmega328p");
    avr_init(avr);
    avr->log = LOG_ERROR;
    avr->sleep = slept;
    avr->run_cycle_limit = 100000;
    firmware.frequency = 16000000;
    avr_load_firmware(avr, &firmware);
    avr->frequency = 16000000;
    avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
    flags &= ~(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POOL_SLEEP);
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), sent, NULL);
    for (int axis = 0; axis < 2; axis++)
        pin[axis] = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), 2 + axis);

    if (!fgets(line, sizeof line, stdin) || !order(line))
        return 2;
    if (pty) {
        struct termios raw;

        sink = posix_openpt(O_RDWR | O_NOCTTY);
        grantpt(sink);
        unlockpt(sink);
        held = open(ptsname(sink), O_RDWR | O_NOCTTY);
        tcgetattr(held, &raw);
        cfmakeraw(&raw);
        tcsetattr(held, TCSANOW, &raw);
        printf("%s\n", ptsname(sink));
        fflush(stdout);
    }
    avr_cycle_timer_register(avr, 1000, period, NULL);
    while (avr->cycle < seconds * 16e6) {
        avr_cycle_count_t stop = avr->cycle + 160000;
        struct pollfd input = {STDIN_FILENO, POLLIN, 0};

        while (avr->cycle < stop)
            if (avr_run(avr) == cpu_Crashed)
                return 3;
        if (pty)
            usleep(1000);
        if (pty && poll(&input, 1, 0) > 0) {
            if (!fgets(line, sizeof line, stdin))
                break;
            if (order(line)) {
                /* In force from the next period on. */
                while (memcmp(&now, &next, sizeof now))
                    avr_run(avr);
                puts("ok");
                fflush(stdout);
            }
        }
    }
    fprintf(stderr, "%lu\n", (unsigned long)avr->cycle);
    return 0;
}
