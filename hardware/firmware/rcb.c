/* RCB/1, the robot's side. See rcb.h for the interface and README.md for the rules. */

#include "rcb.h"

#include <string.h>

enum { HELLO_SIZE = 7, COMMAND_SIZE = 9, STOP_SIZE = 5, HELLO_ACK_SIZE = 15, STATUS_SIZE = 21, CRC_SIZE = 2 };

static uint16_t read16(const uint8_t *in) { return (uint16_t)(in[0] | ((uint16_t)in[1] << 8)); }

static uint32_t read32(const uint8_t *in) { return read16(in) | ((uint32_t)read16(in + 2) << 16); }

static uint8_t *write16(uint8_t *out, uint16_t value) {
    out[0] = (uint8_t)(value & 0xFFu);
    out[1] = (uint8_t)(value >> 8);
    return out + 2;
}

static uint8_t *write32(uint8_t *out, uint32_t value) {
    return write16(write16(out, (uint16_t)(value & 0xFFFFu)), (uint16_t)(value >> 16));
}

static uint8_t guarded(uint8_t buttons) { return (uint8_t)(buttons | ((~(unsigned)buttons & 0x0Fu) << 4)); }

uint16_t rcb_crc(const uint8_t *data, size_t length) {
    uint16_t crc = 0xFFFFu;
    for (size_t i = 0; i < length; i++) {
        crc = (uint16_t)(crc ^ (uint16_t)((uint16_t)data[i] << 8));
        for (uint8_t bit = 0; bit < 8; bit++) {
            uint16_t const shifted = (uint16_t)((uint32_t)crc << 1);
            crc = (crc & 0x8000u) ? (uint16_t)(shifted ^ 0x1021u) : shifted;
        }
    }
    return crc;
}

size_t rcb_encode(const uint8_t *body, size_t length, uint8_t *out) {
    uint8_t crc[CRC_SIZE];
    write16(crc, rcb_crc(body, length));
    size_t code_at = 0, end = 1;
    for (size_t i = 0; i < length + CRC_SIZE; i++) {
        uint8_t const byte = i < length ? body[i] : crc[i - length];
        if (byte != 0) {
            out[end++] = byte;
        } else {
            out[code_at] = (uint8_t)(end - code_at);
            code_at = end++;
        }
    }
    out[code_at] = (uint8_t)(end - code_at);
    out[end++] = 0;
    return end;
}

/* Decode COBS in place; return the decoded length, 0 if the bytes are invalid. */
static uint8_t decode(uint8_t *data, uint8_t length) {
    uint8_t in = 0, out = 0;
    while (in < length) {
        uint8_t const next = (uint8_t)(in + data[in]);
        if (next > length || next <= in) {
            return 0;
        }
        for (in++; in < next; in++) {
            data[out++] = data[in];
        }
        if (in < length) {
            data[out++] = 0;
        }
    }
    return out;
}

/* Queue a frame for the wire; without room for all of it, drop it: the next one is newer. */
static void transmit(rcb_core *core, const uint8_t *body, uint8_t length) {
    if (core->out_begin > 0) {
        core->out_end = (uint8_t)(core->out_end - core->out_begin);
        memmove(core->out, core->out + core->out_begin, core->out_end);
        core->out_begin = 0;
    }
    if (length + CRC_SIZE + 2 <= RCB_OUTPUT_SIZE - core->out_end) {
        core->out_end = (uint8_t)(core->out_end + rcb_encode(body, length, core->out + core->out_end));
    }
}

static void report(rcb_core *core, uint32_t now_ms) {
    uint8_t body[STATUS_SIZE] = {RCB_STATUS};
    uint8_t *at = write16(body + 1, core->session);
    at = write16(at, core->last_sequence);
    *at++ = core->state;
    *at++ = guarded(core->buttons);
    at = write32(at, now_ms);
    at = write16(at, core->crc);
    at = write16(at, core->length);
    at = write16(at, core->duplicate);
    at = write16(at, core->late);
    write16(at, core->trips);
    transmit(core, body, STATUS_SIZE);
    core->status_at = now_ms;
}

static void acknowledge(rcb_core *core, uint32_t nonce, uint16_t session) {
    uint8_t body[HELLO_ACK_SIZE] = {RCB_HELLO_ACK, RCB_MAJOR, RCB_MINOR};
    uint8_t *at = write16(body + 3, core->firmware_build);
    *at++ = RCB_TIME_TO_LIVE_MAX;
    *at++ = core->reset_cause;
    at = write16(at, core->boot_count);
    at = write32(at, nonce);
    write16(at, session);
    transmit(core, body, HELLO_ACK_SIZE);
}

static void release(rcb_core *core, uint8_t state) {
    core->buttons = 0;
    core->state = state;
}

/* Another session number, without a zero byte: those need COBS codes, whose damage a CRC detects less well. */
static uint16_t next_session(const rcb_core *core, uint32_t nonce) {
    uint16_t session = (uint16_t)(core->session ^ core->boot_count ^ (nonce & 0xFFFFu) ^ (nonce >> 16));
    do {
        session = (uint16_t)((uint32_t)session * 25173u + 13849u);
    } while ((session & 0xFFu) == 0 || (session >> 8) == 0 || session == core->session);
    return session;
}

static void receive_hello(rcb_core *core, const uint8_t *body) {
    uint32_t const nonce = read32(body + 3);
    if (body[1] != RCB_MAJOR) {
        release(core, RCB_WAITING);
        acknowledge(core, nonce, 0);
        return;
    }
    if (core->state == RCB_WAITING || nonce != core->nonce) { /* else the same HELLO came twice */
        release(core, RCB_NEUTRAL);
        core->session = next_session(core, nonce);
        core->nonce = nonce;
        core->last_sequence = 0;
    }
    acknowledge(core, nonce, core->session);
}

/* Return by how many ms the command's transit exceeds the shortest one; -1 if it is too late or from the future. */
static int32_t lateness(rcb_core *core, const struct rcb_command *command, uint32_t now_ms) {
    uint16_t const difference = (uint16_t)(((now_ms & 0xFFFFu) - command->host_ms) & 0xFFFFu);
    if (core->state == RCB_NEUTRAL) {
        core->offset = difference;
        core->leak_at = now_ms;
        return 0;
    }
    while (now_ms - core->leak_at >= RCB_LEAK_PERIOD) {
        core->offset = (uint16_t)(core->offset + 1u);
        core->leak_at += RCB_LEAK_PERIOD;
    }
    uint16_t const later = (uint16_t)(difference - core->offset);
    if (later < (uint16_t)(command->time_to_live * 10)) {
        return later;
    }
    if (later < (uint16_t)(0u - RCB_TIME_TO_LIVE_MAX * 10u)) {
        return -1;
    }
    core->offset = difference;
    return 0;
}

static void receive_command(rcb_core *core, const struct rcb_command *command, uint32_t now_ms) {
    if (core->state != RCB_NEUTRAL && core->state != RCB_DRIVING) {
        return;
    }
    uint16_t const step = (uint16_t)(command->sequence - core->last_sequence);
    uint16_t const step_max = core->state == RCB_DRIVING ? RCB_SEQUENCE_STEP_MAX : 0x7FFFu;
    if (command->session != core->session || step == 0 || step > step_max) {
        core->duplicate++;
        return;
    }
    if (core->state == RCB_NEUTRAL && command->buttons != 0) {
        return;
    }
    int32_t const spent = lateness(core, command, now_ms);
    if (spent < 0) {
        core->late++;
        return;
    }
    core->state = RCB_DRIVING;
    core->buttons = command->buttons;
    core->last_sequence = command->sequence;
    core->deadline = now_ms + command->time_to_live * 10u - (uint32_t)spent;
    core->command = *command;
    core->accepted++;
    report(core, now_ms);
}

/* Whether the buttons and their complement agree, exclude each other, and the time to live is allowed. */
static uint8_t is_legal(uint8_t buttons, uint8_t time_to_live) {
    uint8_t const both_ways = RCB_FORWARD | RCB_BACKWARD, both_sides = RCB_LEFT | RCB_RIGHT;
    return (buttons ^ (buttons >> 4) ^ 0x0F) % 16 == 0 && (buttons & both_ways) != both_ways
           && (buttons & both_sides) != both_sides && time_to_live > 0 && time_to_live <= RCB_TIME_TO_LIVE_MAX;
}

static void receive_frame(rcb_core *core, uint32_t now_ms) {
    uint8_t *const body = core->in;
    uint8_t const decoded = core->overlong ? 0 : decode(body, core->received);
    if (decoded <= CRC_SIZE) {
        core->length++;
        return;
    }
    uint8_t const length = (uint8_t)(decoded - CRC_SIZE);
    if (rcb_crc(body, length) != read16(body + length)) {
        core->crc++;
    } else if (body[0] == RCB_HELLO && length == HELLO_SIZE) {
        receive_hello(core, body);
    } else if (body[0] == RCB_COMMAND && length == COMMAND_SIZE && is_legal(body[7], body[8])) {
        struct rcb_command const command = {
            read16(body + 1), read16(body + 3), read16(body + 5), body[7] & 0x0Fu, body[8],
        };
        receive_command(core, &command, now_ms);
    } else if (body[0] == RCB_STOP && length == STOP_SIZE) {
        release(core, RCB_WAITING);
        report(core, now_ms);
    } else {
        core->length++;
    }
}

void rcb_init(rcb_core *core, uint16_t firmware_build, uint8_t reset_cause, uint16_t boot_count) {
    memset(core, 0, sizeof *core);
    core->firmware_build = firmware_build;
    core->reset_cause = reset_cause;
    core->boot_count = boot_count;
}

void rcb_receive(rcb_core *core, uint8_t byte, uint32_t now_ms) {
    rcb_tick(core, now_ms); /* first, so that a late command does not reset the dead-man timer */
    if (byte != 0) {
        if (core->received < RCB_ENCODED_MAX) {
            core->in[core->received++] = byte;
        } else {
            core->overlong = 1;
        }
        return;
    }
    if (core->received > 0) {
        receive_frame(core, now_ms);
    }
    core->received = 0;
    core->overlong = 0;
}

void rcb_tick(rcb_core *core, uint32_t now_ms) {
    if (core->state == RCB_DRIVING && (int32_t)(now_ms - core->deadline) >= 0) {
        release(core, RCB_TRIPPED);
        core->trips++;
        report(core, now_ms);
    } else if (now_ms - core->status_at >= RCB_STATUS_PERIOD) {
        report(core, now_ms);
    }
}

uint8_t rcb_buttons(const rcb_core *core) { return core->buttons; }

uint32_t rcb_accepted(const rcb_core *core) { return core->accepted; }

size_t rcb_transmit(rcb_core *core, uint8_t *out, size_t capacity) {
    size_t const waiting = (size_t)(core->out_end - core->out_begin);
    size_t const moved = waiting < capacity ? waiting : capacity;
    if (moved > 0) {
        memcpy(out, core->out + core->out_begin, moved);
    }
    core->out_begin = (uint8_t)(core->out_begin + moved);
    return moved;
}

size_t rcb_size(void) { return sizeof(rcb_core); }
