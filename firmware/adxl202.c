/*
 * Times the pulses of an ADXL202, ADXL202E or ADXL210 with an ATmega328P at 16 MHz (Arduino Uno or Nano), and sends
 * what tiltcal reads, 115200 baud, 8 data bits, no parity, 1 stop bit:
 *
 *     $PTCDC,seq,t1x,t1y,t2x,t2y*hh
 *
 * seq counts sentences from 0; T1 (high time) and T2 (rise to rise) of x and of y are in ticks of 62.5 ns; hh is the XOR
 * of all characters between $ and *. The x output is wired to pin 2 (PD2), the y output to pin 3 (PD3).
 *
 * Both pulses may rise in the same instant, or one while the other is served. With an interrupt for each, the second
 * waits for the first by a few microseconds, which is tens of mg. So one pin is timed at a time, first x, then y, and the
 * other one interrupts nothing.
 *
 * The processor sleeps until an edge comes. From sleep the interrupt takes the same number of cycles each time, for
 * rises and for falls, so the delay leaves T1 and T2. Only an overflow of the timer may keep an edge waiting; a period
 * with an edge so close behind an overflow is timed again.
 */

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <stdbool.h>
#include <stdint.h>

#if F_CPU != 16000000UL
#error "the ticks and the baud rate are those of 16 MHz"
#endif

enum { PIN_X = PD2, PIN_Y = PD3 };

/* Overflows of the timer, 4.096 ms each, after which a measurement ends: 65 ms, where it takes three periods at most. */
enum { PATIENCE = 16 };

/* Ticks after an overflow in which its interrupt may be under way. */
enum { UNSURE = 64 };

/* One pulse and its period, in ticks. */
struct cycle {
    uint32_t t1;
    uint32_t t2;
};

/* What the interrupts leave: overflows of timer 1 since a measurement began; the latest edge, and whether it is new. */
static volatile uint8_t overflows;
static volatile struct {
    uint16_t ticks;
    uint8_t overflows;
    uint8_t pins;
    bool fresh;
} edge;

ISR(PCINT2_vect)
{
    edge.ticks = TCNT1;
    edge.pins = PIND;
    /* The timer may have overflowed since its own interrupt was served last. */
    edge.overflows = overflows + ((TIFR1 & _BV(TOV1)) && edge.ticks < 0x8000);
    edge.fresh = true;
}

ISR(TIMER1_OVF_vect)
{
    overflows++;
}

/* Sleep until the next edge of a pin, to `level`; false where none comes, it goes the other way, or its time is unsure. */
static bool await(uint8_t pin, bool level, uint32_t *ticks)
{
    for (;;) {
        cli();
        if (edge.fresh || overflows >= PATIENCE)
            break;
        /* The instruction behind sei is carried out before any interrupt: no edge comes between it and sleep. */
        sei();
        sleep_cpu();
    }
    if (!edge.fresh)
        return false;
    edge.fresh = false;
    *ticks = (uint32_t)edge.overflows << 16 | edge.ticks;
    return !(edge.pins & _BV(pin)) == !level && edge.ticks >= UNSURE;
}

/* Time one whole period of a pin, from a rise to the next; false where no pulse comes. */
static bool measure(uint8_t pin, struct cycle *found)
{
    uint32_t rise, fall, next;

    cli();
    overflows = 0;
    PCMSK2 = _BV(pin);
    PCIFR = _BV(PCIF2);
    edge.fresh = false;
    /* The first fall may have come before the processor slept, and late; what follows it has not. */
    while (overflows < PATIENCE)
        if (await(pin, false, &fall) && await(pin, true, &rise) && await(pin, false, &fall) && await(pin, true, &next))
            break;
    PCMSK2 = 0;
    found->t1 = fall - rise;
    found->t2 = next - rise;
    return overflows < PATIENCE;
}

static uint8_t checksum;

/* The transmitter has room: its interrupt has done its work by waking the processor. */
ISR(USART_UDRE_vect)
{
    UCSR0B = _BV(TXEN0);
}

static void send(char character)
{
    cli();
    while (!(UCSR0A & _BV(UDRE0))) {
        UCSR0B = _BV(TXEN0) | _BV(UDRIE0);
        sei();
        sleep_cpu();
        cli();
    }
    UDR0 = character;
    checksum ^= character;
}

static void send_text(const char *text)
{
    while (*text)
        send(*text++);
}

static void send_number(uint32_t number)
{
    char digits[10];
    uint8_t length = 0;

    do
        digits[length++] = '0' + number % 10;
    while (number /= 10);
    send(',');
    while (length)
        send(digits[--length]);
}

static void send_sentence(uint32_t number, const struct cycle *x, const struct cycle *y)
{
    static const char hex[] = "0123456789ABCDEF";
    uint8_t sum;

    send('$');
    checksum = 0;
    send_text("PTCDC");
    send_number(number);
    send_number(x->t1);
    send_number(y->t1);
    send_number(x->t2);
    send_number(y->t2);
    sum = checksum;
    send('*');
    send(hex[sum >> 4]);
    send(hex[sum & 15]);
    send_text("\r\n");
}

int main(void)
{
    struct cycle x, y;
    uint32_t number = 0;

    DDRD &= ~(_BV(PIN_X) | _BV(PIN_Y));
    set_sleep_mode(SLEEP_MODE_IDLE);
    sleep_enable();
    PCICR = _BV(PCIE2);
    /* INT0 and INT1 have the same pins; they stay off, and off their level sensing, which costs a simulator its sleep. */
    EICRA = _BV(ISC11) | _BV(ISC01);
    TCCR1A = 0;
    TCCR1B = _BV(CS10);
    /* Always on: were it switched on for a measurement, an overflow just before that might go uncounted. */
    TIMSK1 = _BV(TOIE1);
    /* 16 MHz / 8 / 17 is 117647 baud, 2.1 % beside 115200, as these boards' own boot loader has it. */
    UCSR0A = _BV(U2X0);
    UBRR0 = 16;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(TXEN0);
    for (;;) {
        if (!measure(PIN_X, &x))
            send_text("no pulses on pin 2 (x)\r\n");
        else if (!measure(PIN_Y, &y))
            send_text("no pulses on pin 3 (y)\r\n");
        else
            send_sentence(number++, &x, &y);
    }
}
