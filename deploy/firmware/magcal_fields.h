/* magcal_fields.h: the checks of single values in a payload, as docs/wire.md has them.
 *
 * Part of magcal_decode.h, which includes it.  Each function takes a value that was read, reads what belongs to it, and
 * gives what it holds; where it is not acceptable it sets the reader's fault and gives 0.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef MAGCAL_FIELDS_H
#define MAGCAL_FIELDS_H

#include "magcal_msgpack.h"

#ifdef __cplusplus
extern "C" {
#endif

static inline int magcal_expect(magcal_reader *r, const magcal_value *v, magcal_type type) {
    if (r->fault == MAGCAL_ACCEPTED && v->type != type) {
        const int nested = v->type == MAGCAL_MAP || (v->type == MAGCAL_ARRAY && type != MAGCAL_ARRAY);
        magcal_fault(r, nested ? MAGCAL_REFUSED_TOO_DEEP : MAGCAL_REFUSED_WRONG_TYPE);
    }
    return r->fault == MAGCAL_ACCEPTED;
}

/* A whole number from 0 to `high`. */
static inline uint64_t magcal_as_count(magcal_reader *r, const magcal_value *v, uint64_t high) {
    if (!magcal_expect(r, v, MAGCAL_INTEGER)) return 0;
    if (v->negative || v->bits > high) {
        magcal_fault(r, MAGCAL_REFUSED_OUT_OF_RANGE);
        return 0;
    }
    return v->bits;
}

static inline int64_t magcal_as_int64(magcal_reader *r, const magcal_value *v) {
    int64_t value;
    if (!magcal_expect(r, v, MAGCAL_INTEGER)) return 0;
    if (!v->negative && v->bits > (uint64_t)INT64_MAX) {
        magcal_fault(r, MAGCAL_REFUSED_OUT_OF_RANGE);
        return 0;
    }
    memcpy(&value, &v->bits, sizeof value); /* two's complement on both sides */
    return value;
}

static inline magcal_real magcal_as_real(magcal_reader *r, const magcal_value *v, magcal_real low, magcal_real high) {
    magcal_real value = v->real;
    if (v->type != MAGCAL_INTEGER && !magcal_expect(r, v, MAGCAL_REAL)) return 0;
    if (r->fault != MAGCAL_ACCEPTED) return 0;
    if (v->type == MAGCAL_INTEGER) {
        value = v->negative ? -(magcal_real)(~v->bits + 1u) : (magcal_real)v->bits;
    } else if (!v->finite) {
        magcal_fault(r, MAGCAL_REFUSED_NOT_FINITE);
        return 0;
    }
    if (value < low || value > high) {
        magcal_fault(r, MAGCAL_REFUSED_OUT_OF_RANGE);
        return 0;
    }
    return value;
}

/* How many of `least` to `most` items an array has; they follow. */
static inline int magcal_as_array(magcal_reader *r, const magcal_value *v, unsigned least, unsigned most) {
    if (!magcal_expect(r, v, MAGCAL_ARRAY)) return 0;
    if (v->bits < least || v->bits > most) {
        magcal_fault(r, MAGCAL_REFUSED_WRONG_SHAPE);
        return 0;
    }
    return (int)v->bits;
}

/* An array of `least` to `most` numbers within +-`limit`; how many there are. */
static inline int magcal_as_reals(magcal_reader *r, const magcal_value *v, magcal_real *items, unsigned least,
                                  unsigned most, magcal_real limit) {
    const int count = magcal_as_array(r, v, least, most);
    int i;
    for (i = 0; i < count && r->fault == MAGCAL_ACCEPTED; i++) {
        const magcal_value item = magcal_next(r);
        items[i] = magcal_as_real(r, &item, -limit, limit);
    }
    return count;
}

static inline void magcal_as_vector(magcal_reader *r, const magcal_value *v, magcal_real vector[3], magcal_real limit) {
    magcal_as_reals(r, v, vector, 3, 3, limit);
    if (r->fault != MAGCAL_ACCEPTED) return;
    if (vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2] > limit * limit) {
        magcal_fault(r, MAGCAL_REFUSED_OUT_OF_RANGE);
    }
}

/* The upper triangle, row by row, of a covariance of `rows`; no variance is negative. */
static inline void magcal_as_covariance(magcal_reader *r, const magcal_value *v, magcal_real *items, unsigned rows) {
    const unsigned count = rows * (rows + 1) / 2;
    unsigned row, at = 0;
    magcal_as_reals(r, v, items, count, count, (magcal_real)MAGCAL_COVARIANCE_LIMIT);
    if (r->fault != MAGCAL_ACCEPTED) return;
    for (row = rows; row > 0; at += row--) {
        if (items[at] < 0) magcal_fault(r, MAGCAL_REFUSED_OUT_OF_RANGE);
    }
}

static inline magcal_text magcal_as_name(magcal_reader *r, const magcal_value *v, size_t longest, const char *also) {
    size_t i;
    if (!magcal_expect(r, v, MAGCAL_STRING)) return v->text;
    if (v->text.size == 0 || v->text.size > longest) magcal_fault(r, MAGCAL_REFUSED_BAD_NAME);
    for (i = 0; i < v->text.size; i++) {
        const char c = v->text.bytes[i];
        if (!magcal_is_name_character(c) && (c == '\0' || strchr(also, c) == NULL)) {
            magcal_fault(r, MAGCAL_REFUSED_BAD_NAME);
        }
    }
    return v->text;
}

static inline magcal_text magcal_as_plain_name(magcal_reader *r, const magcal_value *v) {
    return magcal_as_name(r, v, MAGCAL_NAME_LENGTH, "");
}

/* Control characters, separators but the space, and what turns or hides text; not all that Unicode has unassigned. */
static inline int magcal_is_hidden(uint32_t c) {
    return c < 0x20 || (c >= 0x7F && c <= 0xA0) || c == 0xAD || c == 0x1680 || (c >= 0x2000 && c <= 0x200F) ||
           (c >= 0x2028 && c <= 0x202F) || (c >= 0x205F && c <= 0x206F) || c == 0x3000 || c == 0xFEFF ||
           (c >= 0xE000 && c <= 0xF8FF) || (c >= 0xFFF0 && c <= 0xFFFB) || c >= 0xE0000;
}

static inline magcal_text magcal_as_text(magcal_reader *r, const magcal_value *v, size_t longest) {
    const uint8_t *s = (const uint8_t *)v->text.bytes;
    uint32_t character = 0;
    size_t at = 0, size;
    if (!magcal_expect(r, v, MAGCAL_STRING)) return v->text;
    if (v->text.size > longest) magcal_fault(r, MAGCAL_REFUSED_BAD_TEXT);
    while (at < v->text.size && r->fault == MAGCAL_ACCEPTED) {
        size = magcal_utf8(s + at, v->text.size - at, &character);
        if (size == 0 || magcal_is_hidden(character)) magcal_fault(r, MAGCAL_REFUSED_BAD_TEXT);
        at += size;
    }
    return v->text;
}

/* One of the first `count` choices. */
static inline int magcal_as_choice(magcal_reader *r, const magcal_value *v, unsigned count) {
    if (!magcal_expect(r, v, MAGCAL_INTEGER)) return 0;
    if (v->negative || v->bits >= count) {
        magcal_fault(r, MAGCAL_REFUSED_UNKNOWN_CHOICE);
        return 0;
    }
    return (int)v->bits;
}

static inline int magcal_as_truth(magcal_reader *r, const magcal_value *v) {
    return magcal_expect(r, v, MAGCAL_TRUTH) && v->bits != 0;
}

#ifdef __cplusplus
}
#endif

#endif
