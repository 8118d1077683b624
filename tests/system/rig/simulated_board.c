/* The remote's ATmega328P, simulated by simavr, behind stdin and stdout: simulated_board FIRMWARE.elf.
 *
 * A request is u32 microseconds to run, u8 count and as many bytes for the UART, fed at 115200 baud from the start.
 * The reply is u8 PORTD, u8 DDRD, u8 WDTCSR, u16 count and what the UART has sent. */

#define _POSIX_C_SOURCE 200809L

#include <stdint.h>
#include <stdio.h>
#include <unistd.h>

#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>

enum { FREQUENCY = 16000000, BYTE_US = 87, DDRD = 0x2A, PORTD = 0x2B, WDTCSR = 0x60 };

static uint8_t sent[8192];
static uint16_t sent_size;

static void take(struct avr_irq_t *irq, uint32_t value, void *parameter) {
    (void)irq;
    (void)parameter;
    if (sent_size < sizeof sent) {
        sent[sent_size++] = (uint8_t)value;
    }
}

static int run(avr_t *avr, uint64_t microseconds) {
    uint64_t const end = avr->cycle + microseconds * (FREQUENCY / 1000000);
    while (avr->cycle < end) {
        int const state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed) {
            return 1;
        }
    }
    return 0;
}

int main(int argc, char **argv) {
    FILE *const replies = fdopen(dup(STDOUT_FILENO), "wb"); /* simavr chatters on stdout */
    dup2(STDERR_FILENO, STDOUT_FILENO);
    elf_firmware_t firmware = {0};
    if (replies == NULL || argc != 2 || elf_read_firmware(argv[1], &firmware) != 0) {
        return 2;
    }
    avr_t *const avr = avr_make_mcu_by_name("atmega328p");
    avr_init(avr);
    avr->frequency = FREQUENCY;
    avr->log = LOG_ERROR;
    avr_load_firmware(avr, &firmware);
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), take, NULL);
    avr_irq_t *const input = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);

    uint32_t microseconds;
    uint8_t count, bytes[255];
    while (fread(&microseconds, 4, 1, stdin) == 1 && fread(&count, 1, 1, stdin) == 1) {
        if (fread(bytes, 1, count, stdin) != count) {
            return 2;
        }
        for (uint8_t i = 0; i < count; i++) {
            avr_raise_irq(input, bytes[i]);
            if (run(avr, BYTE_US)) {
                return 3;
            }
        }
        uint64_t const spent = (uint64_t)count * BYTE_US;
        if (microseconds > spent && run(avr, microseconds - spent)) {
            return 3;
        }
        uint8_t const pins[3] = {avr->data[PORTD], avr->data[DDRD], avr->data[WDTCSR]};
        fwrite(pins, 1, sizeof pins, replies);
        fwrite(&sent_size, sizeof sent_size, 1, replies);
        fwrite(sent, 1, sent_size, replies);
        fflush(replies);
        sent_size = 0;
    }
    return 0;
}
