/* magcal_messages.h: what the daemon sends as structures, and the way to them from a payload.
 *
 * Part of magcal_decode.h, which includes it.  Units are in the names; docs/wire.md has each value's meaning.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef MAGCAL_MESSAGES_H
#define MAGCAL_MESSAGES_H

#include "magcal_fields.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A reason or a hazard: MAGCAL_REASON_... or MAGCAL_HAZARD_..., MAGCAL_UNKNOWN_NAME where it is newer than this kit. */
typedef struct {
    int code;
    magcal_text name;
} magcal_named;

/* How far vectors may be off by what would not have been seen yet [nT] (docs/integrity.md), and the hazard that sets
 * it; `known` is 0 while it is not said. */
typedef struct {
    int known;
    magcal_real nt;
    magcal_named by;
} magcal_protection;

/* The answer to one magnetometer sample: craft, source, sequence and time of the message are that sample's. */
typedef struct {
    magcal_real field_body_nt[3];
    magcal_real covariance_nt2[6]; /* xx, xy, xz, yy, yz, zz */
    int verdict;                   /* MAGCAL_VERDICT_... */
    magcal_protection protection;
} magcal_calibrated;

/* The nine errors after a tick. */
typedef struct {
    magcal_text method;
    uint64_t tick;
    magcal_real bias_nt[3];
    magcal_real D[6];           /* D11, D22, D33, D12, D13, D23 */
    magcal_real covariance[45]; /* upper triangle, row by row, of (bias_nt, D) */
    int verdict;
    int reason_count;
    magcal_named reasons[MAGCAL_MAX_REASONS];
    magcal_text remedy;
    magcal_real residual_rms_nt;
    magcal_real noise_nt;
    uint64_t samples_used;
    magcal_protection protection;
} magcal_estimate;

/* Names with counts, or a command's arguments, still as they came: magcal_next_counter takes one after the other. */
typedef struct {
    magcal_reader rest;
    unsigned left;
} magcal_map;

typedef struct {
    magcal_real uptime_s;
    int verdict;
    magcal_map counters;
    magcal_text text;
} magcal_status;

/* The answer to one command. */
typedef struct {
    magcal_text name;
    magcal_text command_source;
    uint32_t command_sequence;
    int accepted;
    magcal_text text;
} magcal_reply;

#ifdef MAGCAL_DECODE_ALL
typedef struct {
    magcal_real field_body_nt[3];
} magcal_sample;

typedef struct {
    int is_vector;
    magcal_real field_nt[3];
    int axes;
    magcal_real magnitude_nt;
} magcal_reference;

typedef struct {
    magcal_real position_km[3];
    int axes;
} magcal_place;

typedef struct {
    magcal_text channel;
    magcal_text unit;
    int count;
    magcal_real values[MAGCAL_MAX_VALUES];
} magcal_channel;

typedef struct {
    magcal_text name;
    magcal_map arguments;
} magcal_request;
#endif

typedef struct {
    int kind; /* MAGCAL_KIND_...: which of `of` */
    magcal_text craft;
    magcal_text source;
    uint32_t sequence;
    int64_t time_ns;
    int clock;
    union {
        magcal_calibrated calibrated;
        magcal_estimate estimate;
        magcal_status status;
        magcal_reply reply;
#ifdef MAGCAL_DECODE_ALL
        magcal_sample magnetometer;
        magcal_reference reference;
        magcal_place position;
        magcal_channel telemetry;
        magcal_request command;
#endif
    } of;
} magcal_message;

/* The next counter of a status; 0 after the last. */
static inline int magcal_next_counter(magcal_map *map, magcal_text *name, uint64_t *count) {
    magcal_value key, value;
    if (map->left == 0) return 0;
    map->left--;
    key = magcal_next(&map->rest);
    value = magcal_next(&map->rest);
    *name = key.text;
    *count = value.bits;
    return map->rest.fault == MAGCAL_ACCEPTED;
}

/* A map's entries are looked at one by one and left for later; each name once, or one of 2 or more is a wrong shape. */
static inline int magcal_is_again(magcal_map map, magcal_text name, unsigned before) {
    while (before-- > 0) {
        const magcal_value key = magcal_next(&map.rest);
        (void)magcal_next(&map.rest);
        if (key.text.size == name.size && memcmp(key.text.bytes, name.bytes, name.size) == 0) return 1;
    }
    return 0;
}

static inline void magcal_check_argument(magcal_reader *r, const magcal_value *v) {
    if (v->type == MAGCAL_STRING) {
        (void)magcal_as_text(r, v, MAGCAL_ARGUMENT_TEXT_BYTES);
    } else if (v->type == MAGCAL_REAL && !v->finite) {
        magcal_fault(r, MAGCAL_REFUSED_NOT_FINITE);
    } else if (v->type == MAGCAL_INTEGER) {
        (void)magcal_as_int64(r, v);
    } else if (v->type != MAGCAL_TRUTH) {
        (void)magcal_expect(r, v, MAGCAL_REAL);
    }
}

static inline magcal_map magcal_as_map(magcal_reader *r, const magcal_value *v, int is_counters) {
    magcal_map map;
    unsigned i;
    map.left = 0;
    map.rest = *r;
    if (v->type != MAGCAL_MAP) {
        magcal_fault(r, v->type == MAGCAL_ARRAY ? MAGCAL_REFUSED_TOO_DEEP : MAGCAL_REFUSED_WRONG_TYPE);
        return map;
    }
    map.left = (unsigned)v->bits;
    if (v->bits > (is_counters ? MAGCAL_MAX_COUNTERS : MAGCAL_MAX_ARGUMENTS)) {
        magcal_fault(r, MAGCAL_REFUSED_WRONG_SHAPE);
    }
    for (i = 0; i < map.left && r->fault == MAGCAL_ACCEPTED; i++) {
        const magcal_value key = magcal_next(r), value = magcal_next(r);
        (void)magcal_as_name(r, &key, is_counters ? MAGCAL_COUNTER_NAME_LENGTH : MAGCAL_NAME_LENGTH,
                             is_counters ? ".:/" : "");
        if (r->fault == MAGCAL_ACCEPTED && magcal_is_again(map, key.text, i)) {
            magcal_fault(r, MAGCAL_REFUSED_WRONG_SHAPE);
        }
        if (is_counters) {
            (void)magcal_as_count(r, &value, MAGCAL_MAX_COUNT);
        } else {
            magcal_check_argument(r, &value);
        }
    }
    return map;
}

static inline void magcal_take_protection(magcal_reader *r, const magcal_value *v, magcal_protection *p) {
    p->known = v->type != MAGCAL_NIL;
    p->nt = p->known ? magcal_as_real(r, v, 0, (magcal_real)MAGCAL_RESULT_LIMIT_NT) : 0;
}

/* Both or neither; this is the last value of its kind. */
static inline void magcal_take_hazard(magcal_reader *r, const magcal_value *v, magcal_protection *p) {
    const int given = v->type != MAGCAL_NIL;
    p->by.code = MAGCAL_UNKNOWN_NAME;
    p->by.name = v->text;
    if (given) p->by.name = magcal_as_plain_name(r, v);
    if (r->fault != MAGCAL_ACCEPTED) return;
    if (given != p->known) magcal_fault(r, MAGCAL_REFUSED_WRONG_SHAPE);
    if (given) p->by.code = magcal_hazard_of(v->text.bytes, v->text.size);
}

static inline void magcal_take_calibrated(magcal_reader *r, int index, const magcal_value *v, magcal_calibrated *c) {
    switch (index) {
        case MAGCAL_CALIBRATED_FIELD_BODY_NT:
            magcal_as_vector(r, v, c->field_body_nt, (magcal_real)MAGCAL_RESULT_LIMIT_NT);
            break;
        case MAGCAL_CALIBRATED_COVARIANCE_NT2: magcal_as_covariance(r, v, c->covariance_nt2, 3); break;
        case MAGCAL_CALIBRATED_VERDICT: c->verdict = magcal_as_choice(r, v, MAGCAL_VERDICTS); break;
        case MAGCAL_CALIBRATED_PROTECTION_NT: magcal_take_protection(r, v, &c->protection); break;
        case MAGCAL_CALIBRATED_PROTECTION_BY: magcal_take_hazard(r, v, &c->protection); break;
        default: break;
    }
}

static inline void magcal_take_reasons(magcal_reader *r, const magcal_value *v, magcal_estimate *e) {
    int i;
    e->reason_count = magcal_as_array(r, v, 0, MAGCAL_MAX_REASONS);
    for (i = 0; i < e->reason_count && r->fault == MAGCAL_ACCEPTED; i++) {
        const magcal_value item = magcal_next(r);
        e->reasons[i].name = magcal_as_plain_name(r, &item);
        if (r->fault == MAGCAL_ACCEPTED) e->reasons[i].code = magcal_reason_of(item.text.bytes, item.text.size);
    }
}

static inline void magcal_take_estimate(magcal_reader *r, int index, const magcal_value *v, magcal_estimate *e) {
    const magcal_real limit = (magcal_real)MAGCAL_RESULT_LIMIT_NT;
    switch (index) {
        case MAGCAL_ESTIMATE_METHOD: e->method = magcal_as_plain_name(r, v); break;
        case MAGCAL_ESTIMATE_TICK: e->tick = magcal_as_count(r, v, MAGCAL_MAX_COUNT); break;
        case MAGCAL_ESTIMATE_BIAS_NT: magcal_as_vector(r, v, e->bias_nt, limit); break;
        case MAGCAL_ESTIMATE_D: magcal_as_reals(r, v, e->D, 6, 6, (magcal_real)MAGCAL_D_LIMIT); break;
        case MAGCAL_ESTIMATE_COVARIANCE: magcal_as_covariance(r, v, e->covariance, 9); break;
        case MAGCAL_ESTIMATE_VERDICT: e->verdict = magcal_as_choice(r, v, MAGCAL_VERDICTS); break;
        case MAGCAL_ESTIMATE_REASONS: magcal_take_reasons(r, v, e); break;
        case MAGCAL_ESTIMATE_REMEDY: e->remedy = magcal_as_text(r, v, MAGCAL_TEXT_BYTES); break;
        case MAGCAL_ESTIMATE_RESIDUAL_RMS_NT: e->residual_rms_nt = magcal_as_real(r, v, 0, limit); break;
        case MAGCAL_ESTIMATE_NOISE_NT: e->noise_nt = magcal_as_real(r, v, 0, limit); break;
        case MAGCAL_ESTIMATE_SAMPLES_USED: e->samples_used = magcal_as_count(r, v, MAGCAL_MAX_COUNT); break;
        case MAGCAL_ESTIMATE_PROTECTION_NT: magcal_take_protection(r, v, &e->protection); break;
        case MAGCAL_ESTIMATE_PROTECTION_BY: magcal_take_hazard(r, v, &e->protection); break;
        default: break;
    }
}

static inline void magcal_take_status(magcal_reader *r, int index, const magcal_value *v, magcal_status *s) {
    switch (index) {
        case MAGCAL_STATUS_UPTIME_S: s->uptime_s = magcal_as_real(r, v, 0, (magcal_real)1e12); break;
        case MAGCAL_STATUS_VERDICT: s->verdict = magcal_as_choice(r, v, MAGCAL_VERDICTS); break;
        case MAGCAL_STATUS_COUNTERS: s->counters = magcal_as_map(r, v, 1); break;
        case MAGCAL_STATUS_TEXT: s->text = magcal_as_text(r, v, MAGCAL_TEXT_BYTES); break;
        default: break;
    }
}

static inline void magcal_take_reply(magcal_reader *r, int index, const magcal_value *v, magcal_reply *p) {
    switch (index) {
        case MAGCAL_REPLY_NAME: p->name = magcal_as_plain_name(r, v); break;
        case MAGCAL_REPLY_COMMAND_SOURCE: p->command_source = magcal_as_plain_name(r, v); break;
        case MAGCAL_REPLY_COMMAND_SEQUENCE: p->command_sequence = (uint32_t)magcal_as_count(r, v, UINT32_MAX); break;
        case MAGCAL_REPLY_ACCEPTED: p->accepted = magcal_as_truth(r, v); break;
        case MAGCAL_REPLY_TEXT: p->text = magcal_as_text(r, v, MAGCAL_TEXT_BYTES); break;
        default: break;
    }
}

#ifdef MAGCAL_DECODE_ALL
static inline void magcal_take_reference(magcal_reader *r, int index, const magcal_value *v, magcal_reference *h) {
    const magcal_real limit = (magcal_real)MAGCAL_FIELD_LIMIT_NT;
    const int given = v->type != MAGCAL_NIL;
    if (index == MAGCAL_REFERENCE_FIELD_NT) {
        h->is_vector = given;
        if (given) magcal_as_vector(r, v, h->field_nt, limit);
    } else if (index == MAGCAL_REFERENCE_FRAME) {
        h->axes = given ? magcal_as_choice(r, v, MAGCAL_NED + 1) : MAGCAL_NED + 1;
    } else {
        if (given) h->magnitude_nt = magcal_as_real(r, v, 0, limit);
        if (given == h->is_vector || h->is_vector != (h->axes <= MAGCAL_NED)) {
            magcal_fault(r, MAGCAL_REFUSED_WRONG_SHAPE);
        }
    }
}

static inline void magcal_take_telemetry(magcal_reader *r, int index, const magcal_value *v, magcal_channel *c) {
    if (index == MAGCAL_TELEMETRY_CHANNEL) {
        c->channel = magcal_as_plain_name(r, v);
    } else if (index == MAGCAL_TELEMETRY_UNIT) {
        c->unit = magcal_as_text(r, v, MAGCAL_UNIT_BYTES);
    } else {
        c->count = magcal_as_reals(r, v, c->values, 1, MAGCAL_MAX_VALUES, (magcal_real)MAGCAL_TELEMETRY_LIMIT);
    }
}

static inline void magcal_take_sent(magcal_reader *r, int index, const magcal_value *v, magcal_message *m) {
    if (m->kind == MAGCAL_KIND_MAGNETOMETER) {
        magcal_as_vector(r, v, m->of.magnetometer.field_body_nt, (magcal_real)MAGCAL_FIELD_LIMIT_NT);
    } else if (m->kind == MAGCAL_KIND_REFERENCE) {
        magcal_take_reference(r, index, v, &m->of.reference);
    } else if (m->kind == MAGCAL_KIND_TELEMETRY) {
        magcal_take_telemetry(r, index, v, &m->of.telemetry);
    } else if (m->kind == MAGCAL_KIND_POSITION && index == MAGCAL_POSITION_POSITION_KM) {
        magcal_as_vector(r, v, m->of.position.position_km, (magcal_real)MAGCAL_POSITION_LIMIT_KM);
    } else if (m->kind == MAGCAL_KIND_POSITION) {
        m->of.position.axes = magcal_as_choice(r, v, MAGCAL_ECEF + 1);
    } else if (index == MAGCAL_COMMAND_NAME) {
        m->of.command.name = magcal_as_plain_name(r, v);
    } else {
        m->of.command.arguments = magcal_as_map(r, v, 0);
    }
}
#endif

static inline void magcal_take_value(magcal_reader *r, int index, const magcal_value *v, magcal_message *m) {
    switch (m->kind) {
        case MAGCAL_KIND_CALIBRATED: magcal_take_calibrated(r, index, v, &m->of.calibrated); break;
        case MAGCAL_KIND_ESTIMATE: magcal_take_estimate(r, index, v, &m->of.estimate); break;
        case MAGCAL_KIND_STATUS: magcal_take_status(r, index, v, &m->of.status); break;
        case MAGCAL_KIND_REPLY: magcal_take_reply(r, index, v, &m->of.reply); break;
#ifdef MAGCAL_DECODE_ALL
        default: magcal_take_sent(r, index, v, m); break;
#else
        default: break;
#endif
    }
}

/* How few and how many values a kind has; 0 for one that this end does not take. */
static inline int magcal_values_of(int kind, int *least) {
    switch (kind) {
        case MAGCAL_KIND_CALIBRATED: *least = MAGCAL_CALIBRATED_LEAST; return MAGCAL_CALIBRATED_MOST;
        case MAGCAL_KIND_ESTIMATE: *least = MAGCAL_ESTIMATE_LEAST; return MAGCAL_ESTIMATE_MOST;
        case MAGCAL_KIND_STATUS: *least = MAGCAL_STATUS_LEAST; return MAGCAL_STATUS_MOST;
        case MAGCAL_KIND_REPLY: *least = MAGCAL_REPLY_LEAST; return MAGCAL_REPLY_MOST;
#ifdef MAGCAL_DECODE_ALL
        case MAGCAL_KIND_MAGNETOMETER: *least = MAGCAL_MAGNETOMETER_LEAST; return MAGCAL_MAGNETOMETER_MOST;
        case MAGCAL_KIND_REFERENCE: *least = MAGCAL_REFERENCE_LEAST; return MAGCAL_REFERENCE_MOST;
        case MAGCAL_KIND_POSITION: *least = MAGCAL_POSITION_LEAST; return MAGCAL_POSITION_MOST;
        case MAGCAL_KIND_TELEMETRY: *least = MAGCAL_TELEMETRY_LEAST; return MAGCAL_TELEMETRY_MOST;
        case MAGCAL_KIND_COMMAND: *least = MAGCAL_COMMAND_LEAST; return MAGCAL_COMMAND_MOST;
#endif
        default: *least = 0; return 0;
    }
}

/* The array, its version and its kind; how many values it has, and how many it could have. */
static inline int magcal_take_kind(magcal_reader *r, magcal_message *m, int *most) {
    const magcal_value array = magcal_next(r);
    magcal_value version, kind;
    int least;
    if (r->fault == MAGCAL_ACCEPTED && (array.type != MAGCAL_ARRAY || array.bits < 2)) {
        magcal_fault(r, MAGCAL_REFUSED_WRONG_SHAPE);
    }
    version = magcal_next(r);
    if (version.type != MAGCAL_INTEGER) magcal_fault(r, MAGCAL_REFUSED_WRONG_TYPE);
    kind = magcal_next(r);
    if (kind.type != MAGCAL_INTEGER) magcal_fault(r, MAGCAL_REFUSED_WRONG_TYPE);
    if (version.negative || version.bits != MAGCAL_SCHEMA_VERSION) magcal_fault(r, MAGCAL_REFUSED_UNKNOWN_VERSION);
    m->kind = kind.negative || kind.bits > 255 ? 0 : (int)kind.bits;
    *most = magcal_values_of(m->kind, &least);
    if (*most == 0) magcal_fault(r, MAGCAL_REFUSED_UNKNOWN_KIND);
    if (array.bits < (uint64_t)least || array.bits > (uint64_t)*most) magcal_fault(r, MAGCAL_REFUSED_WRONG_SHAPE);
    return (int)array.bits;
}

static inline void magcal_take_origin(magcal_reader *r, magcal_message *m) {
    magcal_value v = magcal_next(r);
    m->craft = magcal_as_plain_name(r, &v);
    v = magcal_next(r);
    m->source = magcal_as_plain_name(r, &v);
    v = magcal_next(r);
    m->sequence = (uint32_t)magcal_as_count(r, &v, UINT32_MAX);
    v = magcal_next(r);
    m->time_ns = magcal_as_int64(r, &v);
    v = magcal_next(r);
    m->clock = magcal_as_choice(r, &v, MAGCAL_CLOCKS);
}

/* The message of a payload: MAGCAL_ACCEPTED, or why it is refused (MAGCAL_REFUSED_...), and `m` means nothing then. */
static inline int magcal_decode_payload(const uint8_t *payload, size_t size, magcal_message *m) {
    magcal_reader r;
    int count, most = 0, index;
    r.at = payload;
    r.end = payload + size;
    r.fault = MAGCAL_ACCEPTED;
    if (size > MAGCAL_MAX_PAYLOAD_BYTES) return MAGCAL_REFUSED_TOO_LARGE;
    magcal_read_whole(r, &r.fault);
    if (r.fault != MAGCAL_ACCEPTED) return r.fault;
    memset(m, 0, sizeof *m);
    count = magcal_take_kind(&r, m, &most);
    magcal_take_origin(&r, m);
    for (index = MAGCAL_FIRST_OWN; index < most && r.fault == MAGCAL_ACCEPTED; index++) {
        magcal_value v;
        if (index < count) {
            v = magcal_next(&r);
        } else {
            memset(&v, 0, sizeof v); /* nil: an optional value that was left out */
        }
        if (r.fault == MAGCAL_ACCEPTED) magcal_take_value(&r, index, &v, m);
    }
    return r.fault;
}

#ifdef __cplusplus
}
#endif

#endif
