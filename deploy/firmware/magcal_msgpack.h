/* magcal_msgpack.h: the msgpack values of a payload, one after the other, never beyond its end.
 *
 * Part of magcal_decode.h, which includes it.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef MAGCAL_MSGPACK_H
#define MAGCAL_MSGPACK_H

#include "magcal_encode.h"

#ifdef __cplusplus
extern "C" {
#endif

#define MAGCAL_ACCEPTED (-1)
#define MAGCAL_LONGEST_ARRAY 45 /* the covariance of the nine errors */
#define MAGCAL_DEEPEST 4        /* arrays and maps within each other; no message has more than 2 */

/* Bytes of a payload in UTF-8, without a 0 at their end: printf("%.*s", (int)text.size, text.bytes). */
typedef struct {
    const char *bytes;
    size_t size;
} magcal_text;

static inline int magcal_text_is(magcal_text text, const char *string) {
    return magcal_same(text.bytes, text.size, string);
}

typedef enum {
    MAGCAL_NIL,
    MAGCAL_TRUTH,
    MAGCAL_INTEGER,
    MAGCAL_REAL,
    MAGCAL_STRING,
    MAGCAL_ARRAY,
    MAGCAL_MAP,
    MAGCAL_BINARY,
    MAGCAL_EXTENSION
} magcal_type;

/* One value; of an array or a map only how many follow. */
typedef struct {
    magcal_type type;
    uint64_t bits; /* an integer in two's complement; a truth; how many entries */
    int negative;  /* whether that integer is below 0 */
    int finite;    /* whether a real is */
    magcal_real real;
    magcal_text text;
} magcal_value;

/* Where the reading stands; after the first fault nothing is read any more. */
typedef struct {
    const uint8_t *at;
    const uint8_t *end;
    int fault; /* MAGCAL_ACCEPTED, or MAGCAL_REFUSED_... */
} magcal_reader;

static inline void magcal_fault(magcal_reader *r, int reason) {
    if (r->fault == MAGCAL_ACCEPTED) r->fault = reason;
}

/* A big-endian number of up to 8 bytes; 0 and a fault beyond the end. */
static inline uint64_t magcal_read_bits(magcal_reader *r, size_t size) {
    uint64_t bits = 0;
    if ((size_t)(r->end - r->at) < size) {
        magcal_fault(r, MAGCAL_REFUSED_NOT_MSGPACK);
        return 0;
    }
    while (size-- > 0) bits = bits << 8 | *r->at++;
    return bits;
}

static inline magcal_real magcal_real_of_single(uint32_t bits) {
    float value;
    memcpy(&value, &bits, sizeof value);
    return (magcal_real)value;
}

/* A float 64 as a real of this build; in single precision rounded, beyond its range the largest, below it 0. */
static inline magcal_real magcal_real_of_double(uint64_t bits) {
#ifdef MAGCAL_SINGLE_PRECISION
    const int exponent = (int)(bits >> 52 & 0x7FF) - 1023 + 127;
    const uint32_t sign = (uint32_t)(bits >> 32) & 0x80000000u;
    const uint64_t fraction = bits & 0xFFFFFFFFFFFFFu, rest = fraction & 0x1FFFFFFFu;
    uint32_t single = sign;
    if (exponent >= 255) {
        single |= 0x7F7FFFFFu;
    } else if (exponent > 0) {
        single |= (uint32_t)exponent << 23 | (uint32_t)(fraction >> 29);
        if (rest > 0x10000000u || (rest == 0x10000000u && (single & 1u))) single++; /* half to even */
    }
    return magcal_real_of_single(single);
#else
    magcal_real value;
    memcpy(&value, &bits, sizeof value);
    return value;
#endif
}

/* The length of the UTF-8 character that begins here, 0 where it is none, and its number. */
static inline size_t magcal_utf8(const uint8_t *s, size_t left, uint32_t *character) {
    static const uint32_t least[5] = {0, 0, 0x80, 0x800, 0x10000};
    const size_t size = s[0] < 0x80 ? 1 : s[0] < 0xC0 ? 0 : s[0] < 0xE0 ? 2 : s[0] < 0xF0 ? 3 : s[0] < 0xF8 ? 4 : 0;
    size_t i;
    if (size == 0 || size > left) return 0;
    *character = size == 1 ? s[0] : s[0] & (0x7Fu >> size);
    for (i = 1; i < size; i++) {
        if ((s[i] & 0xC0) != 0x80) return 0;
        *character = *character << 6 | (s[i] & 0x3Fu);
    }
    if (*character < least[size] || *character > 0x10FFFF || (*character >= 0xD800 && *character < 0xE000)) return 0;
    return size;
}

static inline int magcal_is_utf8(magcal_text text) {
    const uint8_t *s = (const uint8_t *)text.bytes;
    uint32_t character = 0;
    size_t at = 0, size;
    while (at < text.size) {
        size = magcal_utf8(s + at, text.size - at, &character);
        if (size == 0) return 0;
        at += size;
    }
    return 1;
}

/* Bytes of a string, a binary or an extension: all there first, then not too many. */
static inline void magcal_read_run(magcal_reader *r, magcal_value *v, magcal_type type, uint64_t size) {
    v->type = type;
    if ((uint64_t)(r->end - r->at) < size) {
        magcal_fault(r, MAGCAL_REFUSED_NOT_MSGPACK);
        return;
    }
    if (size > (type == MAGCAL_STRING ? MAGCAL_TEXT_BYTES : 0u)) {
        magcal_fault(r, MAGCAL_REFUSED_TOO_LONG);
        return;
    }
    v->text.bytes = (const char *)r->at;
    v->text.size = (size_t)size;
    r->at += size;
    if (type == MAGCAL_EXTENSION) magcal_fault(r, MAGCAL_REFUSED_WRONG_TYPE);
    if (type == MAGCAL_STRING && !magcal_is_utf8(v->text)) magcal_fault(r, MAGCAL_REFUSED_NOT_MSGPACK);
}

static inline void magcal_read_extension(magcal_reader *r, magcal_value *v, uint64_t size) {
    const uint64_t number = magcal_read_bits(r, 1);
    if (number == 0xFF && size == 0) magcal_fault(r, MAGCAL_REFUSED_NOT_MSGPACK); /* a timestamp without its time */
    magcal_read_run(r, v, MAGCAL_EXTENSION, size);
}

static inline void magcal_read_integer(magcal_reader *r, magcal_value *v, unsigned mark) {
    const size_t size = (size_t)1 << (mark & 3u);
    v->type = MAGCAL_INTEGER;
    v->bits = magcal_read_bits(r, size);
    v->negative = mark >= 0xD0 && (v->bits >> (8 * size - 1)) != 0;
    if (v->negative && size < 8) v->bits |= ~(uint64_t)0 << (8 * size);
}

static inline void magcal_read_real(magcal_reader *r, magcal_value *v, unsigned mark) {
    const uint64_t bits = magcal_read_bits(r, mark == 0xCA ? 4 : 8);
    v->type = MAGCAL_REAL;
    v->finite = mark == 0xCA ? (bits & 0x7F800000u) != 0x7F800000u
                             : (bits & 0x7FF0000000000000u) != 0x7FF0000000000000u;
    if (v->finite) v->real = mark == 0xCA ? magcal_real_of_single((uint32_t)bits) : magcal_real_of_double(bits);
}

static inline void magcal_read_count(magcal_reader *r, magcal_value *v, magcal_type type, uint64_t count) {
    v->type = type;
    v->bits = count;
    if (count > (type == MAGCAL_MAP ? MAGCAL_MAX_COUNTERS : MAGCAL_LONGEST_ARRAY)) {
        magcal_fault(r, MAGCAL_REFUSED_TOO_LONG);
    }
}

static inline void magcal_read_marked(magcal_reader *r, magcal_value *v, unsigned mark) {
    if (mark == 0xC0) {
        v->type = MAGCAL_NIL;
    } else if (mark == 0xC2 || mark == 0xC3) {
        v->type = MAGCAL_TRUTH;
        v->bits = mark & 1u;
    } else if (mark >= 0xC4 && mark <= 0xC6) {
        magcal_read_run(r, v, MAGCAL_BINARY, magcal_read_bits(r, (size_t)1 << (mark - 0xC4)));
    } else if (mark >= 0xC7 && mark <= 0xC9) {
        magcal_read_extension(r, v, magcal_read_bits(r, (size_t)1 << (mark - 0xC7)));
    } else if (mark == 0xCA || mark == 0xCB) {
        magcal_read_real(r, v, mark);
    } else if (mark >= 0xCC && mark <= 0xD3) {
        magcal_read_integer(r, v, mark);
    } else if (mark >= 0xD4 && mark <= 0xD8) {
        magcal_read_extension(r, v, (uint64_t)1 << (mark - 0xD4));
    } else if (mark >= 0xD9 && mark <= 0xDB) {
        magcal_read_run(r, v, MAGCAL_STRING, magcal_read_bits(r, (size_t)1 << (mark - 0xD9)));
    } else if (mark >= 0xDC) {
        magcal_read_count(r, v, mark < 0xDE ? MAGCAL_ARRAY : MAGCAL_MAP, magcal_read_bits(r, mark & 1u ? 4 : 2));
    } else { /* 0xC1 */
        magcal_fault(r, MAGCAL_REFUSED_NOT_MSGPACK);
    }
}

/* The next value; nil and a fault where there is none. */
static inline magcal_value magcal_next(magcal_reader *r) {
    magcal_value v;
    unsigned mark;
    memset(&v, 0, sizeof v);
    if (r->fault != MAGCAL_ACCEPTED) return v;
    mark = (unsigned)magcal_read_bits(r, 1);
    if (r->fault != MAGCAL_ACCEPTED) return v;
    if (mark < 0x80 || mark >= 0xE0) {
        v.type = MAGCAL_INTEGER;
        v.negative = mark >= 0xE0;
        v.bits = v.negative ? ~(uint64_t)0xFF | mark : mark;
    } else if (mark < 0x90) {
        magcal_read_count(r, &v, MAGCAL_MAP, mark & 0xFu);
    } else if (mark < 0xA0) {
        magcal_read_count(r, &v, MAGCAL_ARRAY, mark & 0xFu);
    } else if (mark < 0xC0) {
        magcal_read_run(r, &v, MAGCAL_STRING, mark & 0x1Fu);
    } else {
        magcal_read_marked(r, &v, mark);
    }
    return v;
}

/* Whether the bytes are exactly one msgpack value; sets the fault where they are not. */
static inline void magcal_read_whole(magcal_reader r, int *fault) {
    uint64_t left[MAGCAL_DEEPEST + 1] = {1, 0, 0, 0, 0};
    int in_map[MAGCAL_DEEPEST + 1] = {0, 0, 0, 0, 0}, depth = 0;
    while (r.fault == MAGCAL_ACCEPTED && depth >= 0) {
        magcal_value v;
        if (left[depth] == 0) {
            depth--;
            continue;
        }
        v = magcal_next(&r);
        if (in_map[depth] && left[depth] % 2 == 0 && v.type != MAGCAL_STRING && v.type != MAGCAL_BINARY) {
            magcal_fault(&r, MAGCAL_REFUSED_NOT_MSGPACK);
        }
        left[depth]--;
        if (v.type != MAGCAL_ARRAY && v.type != MAGCAL_MAP) continue;
        if (depth == MAGCAL_DEEPEST) {
            magcal_fault(&r, MAGCAL_REFUSED_TOO_DEEP);
            continue;
        }
        depth++;
        in_map[depth] = v.type == MAGCAL_MAP;
        left[depth] = in_map[depth] ? 2 * v.bits : v.bits;
    }
    if (r.at != r.end) magcal_fault(&r, MAGCAL_REFUSED_NOT_MSGPACK);
    *fault = r.fault;
}

#ifdef __cplusplus
}
#endif

#endif
