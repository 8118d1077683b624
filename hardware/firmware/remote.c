/* The remote control of the toy car on an ATmega328P (Arduino Uno, Nano): pins, clock, wire and watchdog
 * around the protocol core. Build and flash with the Makefile in this folder. */

#include <avr/eeprom.h>
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/wdt.h>
#include <util/atomic.h>

#include "rcb.h"
#ifdef ONBOARD
#include "onboard.h"
#endif

enum { FIRMWARE_BUILD = 1 };
enum { BAUD_DIVIDER = F_CPU / 8 / 115200 - 1 }; /* double speed: 2.1 % off at 16 MHz, which the receiver tolerates */
enum { RECEIVED_SIZE = 128 };                   /* a power of two, 11 ms of the wire */

/* D4 to D7, one for each button, high closes it; two on either side of the port's middle. */
enum { PINS = 0xF0 };

static uint16_t EEMEM stored_boot_count;
static rcb_core core;
static volatile uint32_t clock_ms;
static volatile uint8_t received[RECEIVED_SIZE];
static volatile uint8_t received_end;
static uint8_t received_begin;
static uint8_t reset_cause __attribute__((section(".noinit")));

/* Runs before main and before any variable is set. The bootloader of an Uno clears MCUSR and leaves it in r2. */
void first(void) __attribute__((naked, used, section(".init0")));
void first(void) {
    __asm__ volatile("sts %0, r2" : "=m"(reset_cause));
    PORTD &= (uint8_t)~PINS;
    DDRD |= PINS;
}

void second(void) __attribute__((naked, used, section(".init3")));
void second(void) {
    if (MCUSR != 0) {
        reset_cause = MCUSR;
    }
    MCUSR = 0;
    wdt_enable(WDTO_60MS);
}

/* The only place that writes the pins. A mutually exclusive pair opens everything, whoever requests it. */
static void write_pins(uint8_t buttons) {
    uint8_t const both_ways = RCB_FORWARD | RCB_BACKWARD, both_sides = RCB_LEFT | RCB_RIGHT;
    if ((buttons & both_ways) == both_ways || (buttons & both_sides) == both_sides) {
        buttons = 0;
    }
    PORTD = (uint8_t)((PORTD & (uint8_t)~PINS) | (uint8_t)((buttons & 0x0F) << 4));
}

ISR(TIMER0_COMPA_vect) { clock_ms++; }

ISR(USART_RX_vect) {
    uint8_t const damaged = UCSR0A & (_BV(FE0) | _BV(DOR0));
    uint8_t const byte = UDR0;
    uint8_t const next = (uint8_t)((received_end + 1) % RECEIVED_SIZE);
    if (!damaged && next != received_begin) { /* the checksum detects a loss here */
        received[received_end] = byte;
        received_end = next;
    }
}

static uint32_t now(void) {
    uint32_t ms;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { ms = clock_ms; }
    return ms;
}

static uint16_t count_boot(void) {
    uint16_t const count = (uint16_t)(eeprom_read_word(&stored_boot_count) + 1u); /* erased: 0xFFFF, so the first is 0 */
    eeprom_update_word(&stored_boot_count, count);
    return count;
}

int main(void) {
    TCCR0A = _BV(WGM01);
    TCCR0B = _BV(CS01) | _BV(CS00);
    OCR0A = F_CPU / 64 / 1000 - 1;
    TIMSK0 = _BV(OCIE0A);
    UCSR0A = _BV(U2X0);
    UBRR0 = BAUD_DIVIDER;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);

    rcb_init(&core, FIRMWARE_BUILD, reset_cause, count_boot());
#ifdef ONBOARD
    onboard_init();
#endif
    sei();
    for (;;) {
        if (received_begin != received_end) {
            rcb_receive(&core, received[received_begin], now());
            received_begin = (uint8_t)((received_begin + 1) % RECEIVED_SIZE);
        }
        rcb_tick(&core, now());
#ifdef ONBOARD
        write_pins(onboard_buttons(&core, now()));
#else
        write_pins(rcb_buttons(&core));
#endif
        uint8_t byte;
        if ((UCSR0A & _BV(UDRE0)) && rcb_transmit(&core, &byte, 1) == 1) {
            UDR0 = byte;
        }
        wdt_reset();
    }
}
