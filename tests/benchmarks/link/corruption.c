/* Sends commands to the core over a wire that damages bytes, and counts what is accepted.
 *
 * corruption FRAMES RATE SEED: each byte, delimiters too, is with probability RATE replaced by another one, all 255
 * equally likely. Frames come at 20 Hz with up to 10 ms of delay, buttons at random; a robot that has tripped gets
 * a new session over a clean wire, so that every frame meets a robot that listens. Writes one line of numbers. */

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>

#include "rcb.h"

enum { COMMAND_SIZE = 9, WIRE_SIZE = COMMAND_SIZE + 4, PERIOD = 50, JITTER = 10 };

static uint64_t random_state;

/* splitmix64, Steele, Lea and Flood 2014 */
static uint64_t draw(void) {
    uint64_t z = (random_state += 0x9E3779B97F4A7C15u);
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

static size_t pack(const struct rcb_command *command, uint8_t *wire) {
    uint8_t const body[COMMAND_SIZE] = {
        RCB_COMMAND,
        (uint8_t)(command->session & 0xFFu),
        (uint8_t)(command->session >> 8),
        (uint8_t)(command->sequence & 0xFFu),
        (uint8_t)(command->sequence >> 8),
        (uint8_t)(command->host_ms & 0xFFu),
        (uint8_t)(command->host_ms >> 8),
        (uint8_t)(command->buttons | ((~(unsigned)command->buttons & 0x0Fu) << 4)),
        command->time_to_live,
    };
    return rcb_encode(body, COMMAND_SIZE, wire);
}

static void open_session(rcb_core *core, struct rcb_command *command, uint32_t now) {
    uint8_t hello[7] = {RCB_HELLO, RCB_MAJOR, RCB_MINOR};
    uint8_t wire[WIRE_SIZE];
    uint64_t const nonce = draw();
    for (int i = 0; i < 4; i++) {
        hello[3 + i] = (uint8_t)((nonce >> (8 * i)) & 0xFFu);
    }
    size_t size = rcb_encode(hello, sizeof hello, wire);
    rcb_receive(core, 0, now);
    for (size_t i = 0; i < size; i++) {
        rcb_receive(core, wire[i], now);
    }
    command->session = core->session;
    command->sequence = 1;
    command->host_ms = (uint16_t)(now & 0xFFFFu);
    command->buttons = 0;
    command->time_to_live = RCB_TIME_TO_LIVE_MAX;
    size = pack(command, wire);
    for (size_t i = 0; i < size; i++) {
        rcb_receive(core, wire[i], now);
    }
    if (core->state != RCB_DRIVING) {
        fputs("the core refused a clean session\n", stderr);
        exit(1);
    }
}

static int equal(const struct rcb_command *a, const struct rcb_command *b) {
    return a->session == b->session && a->sequence == b->sequence && a->host_ms == b->host_ms
           && a->buttons == b->buttons && a->time_to_live == b->time_to_live;
}

int main(int argc, char **argv) {
    static const uint8_t choices[] = {0, 1, 2, 4, 8, 5, 6, 9, 10};
    if (argc != 4) {
        return 2;
    }
    uint64_t const frames = strtoull(argv[1], NULL, 10);
    uint64_t const threshold = (uint64_t)(strtod(argv[2], NULL) * 4294967296.0);
    random_state = strtoull(argv[3], NULL, 10);
    rcb_core core;
    rcb_init(&core, 1, 1, 1);
    struct rcb_command sent = {0, 0, 0, 0, 0}, before;
    uint64_t damaged_frames = 0, accepted = 0, wrong = 0, wrong_buttons = 0, missed = 0, sessions = 1;
    uint64_t passed = 0; /* damaged frames that passed COBS, length and checksum, whatever became of them */
    uint32_t now = 1000;
    int clean_start = 1;
    open_session(&core, &sent, now);
    for (uint64_t frame = 0; frame < frames; frame++) {
        now += PERIOD;
        rcb_tick(&core, now);
        if (core.state != RCB_DRIVING) {
            open_session(&core, &sent, now);
            sessions++;
            clean_start = 1;
            now += PERIOD;
        }
        before = sent;
        sent.sequence = (uint16_t)(sent.sequence + 1u);
        sent.host_ms = (uint16_t)((now - (uint32_t)(draw() % JITTER)) & 0xFFFFu);
        sent.buttons = choices[draw() % sizeof choices];
        uint8_t wire[WIRE_SIZE];
        size_t const size = pack(&sent, wire);
        int damaged = 0;
        uint32_t const accepted_before = core.accepted;
        uint16_t const refused_before = (uint16_t)(core.duplicate + core.late);
        for (size_t i = 0; i < size; i++) {
            uint64_t const chance = draw();
            if ((chance & 0xFFFFFFFFu) < threshold) {
                wire[i] = (uint8_t)(wire[i] ^ (1u + (uint8_t)((chance >> 32) % 255u)));
                damaged = 1;
            }
            uint32_t const count = core.accepted;
            rcb_receive(&core, wire[i], now);
            if (core.accepted != count && !equal(&core.command, &sent) && !equal(&core.command, &before)) {
                wrong++;
                wrong_buttons += core.command.buttons != sent.buttons;
            }
        }
        uint8_t sink[RCB_OUTPUT_SIZE];
        rcb_transmit(&core, sink, sizeof sink);
        damaged_frames += (uint64_t)damaged;
        accepted += core.accepted - accepted_before;
        if (damaged) {
            passed += core.accepted - accepted_before;
            passed += (uint16_t)(core.duplicate + core.late - refused_before);
        }
        missed += !damaged && clean_start && core.accepted == accepted_before;
        clean_start = wire[size - 1] == 0;
    }
    printf("%" PRIu64 " %" PRIu64 " %" PRIu64 " %" PRIu64 " %" PRIu64 " %" PRIu64 " %" PRIu64 "\n", damaged_frames,
           accepted, passed, wrong, wrong_buttons, missed, sessions);
    return 0;
}
