/* magcal_encode.h: everything that a board sends to magcal, as complete serial frames.
 *
 * C99, no allocation, no library beyond <stdint.h>, <stddef.h> and <string.h>, no state.
 * The bytes are specified in docs/wire.md; the golden frames there are this header's test.
 *
 *     uint8_t frame[MAGCAL_FRAME_BYTES];
 *     magcal_origin origin = {"sat1", "mag0", sequence, time_ns, MAGCAL_CLOCK_ELAPSED};
 *     magcal_real field_body_nt[3] = {21500.25, -13000.5, 38250.0};
 *     size_t size = magcal_magnetometer(frame, frame_sequence, &origin, field_body_nt);
 *     if (size > 0) { uart_write(frame, size); sequence++; frame_sequence++; }
 *
 * Every function returns the number of bytes written, or 0 where the daemon would refuse the message or the frame
 * does not fit: a name outside A-Z a-z 0-9 _ - or not of 1 to 32 characters, a number that is not finite, a field
 * above 1 mT, a clock or frame that does not exist.  Nothing is sent then, and the caller should count it.
 *
 * Numbers go out in double precision.  Define MAGCAL_SINGLE_PRECISION before including for 32-bit numbers (also
 * where `double` has 32 bits): a sample is 12 bytes shorter and resolves 0.004 nT at 60000 nT.
 *
 * Time is the instant of the measurement, not of sending: 1 s of error costs up to 73 nT of reference in orbit.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef MAGCAL_ENCODE_H
#define MAGCAL_ENCODE_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "magcal_wire.h"

#ifdef __cplusplus
extern "C" {
#endif

#define MAGCAL_HEADER_BYTES 6
#define MAGCAL_CRC_BYTES 4
/* Room for the frame of a payload: header, checksum, two delimiters, and a byte of COBS for each 254 begun. */
#define MAGCAL_FRAME_FOR(payload) ((payload) + 14 + ((payload) + 14) / 253)

/* Largest payloads.  Before a kind's own values: array, version, kind; two names; sequence; time; clock. */
#define MAGCAL_NAME_BYTES (2 + MAGCAL_NAME_LENGTH)
#define MAGCAL_ORIGIN_BYTES (3 + 2 * MAGCAL_NAME_BYTES + 5 + 9 + 1)
#define MAGCAL_ARGUMENT_TEXT_BYTES 256
#define MAGCAL_UNIT_BYTES 32
/* A magnetometer, reference or position frame. */
#define MAGCAL_FRAME_BYTES 129
#define MAGCAL_TELEMETRY_FRAME_BYTES \
    MAGCAL_FRAME_FOR(MAGCAL_ORIGIN_BYTES + MAGCAL_NAME_BYTES + 2 + MAGCAL_UNIT_BYTES + 3 + MAGCAL_MAX_VALUES * 9)
/* A command, sealed or not, whose `arguments` are names, numbers and truths, or texts of up to `text` bytes. */
#define MAGCAL_COMMAND_FRAME_BYTES(arguments, text)                                               \
    MAGCAL_FRAME_FOR(MAGCAL_ORIGIN_BYTES + MAGCAL_NAME_BYTES + 1 + 8 + MAGCAL_TAG_BYTES + \
                     (arguments) * (MAGCAL_NAME_BYTES + 9 + (text)))

#ifdef MAGCAL_SINGLE_PRECISION
typedef float magcal_real;
typedef uint32_t magcal_bits;
#define MAGCAL_REAL_MARK 0xCA
#define MAGCAL_EXPONENT 0x7F800000u
#else
typedef double magcal_real;
typedef uint64_t magcal_bits;
#define MAGCAL_REAL_MARK 0xCB
#define MAGCAL_EXPONENT 0x7FF0000000000000u
#endif

/* A negative array size stops the build: the real must be of IEEE 754's size, and a sample must fit its frame. */
typedef char magcal_assert_real[sizeof(magcal_real) == sizeof(magcal_bits) ? 1 : -1];
typedef char magcal_assert_frame[MAGCAL_ORIGIN_BYTES + 1 + 3 * 9 + 2 + 13 <= MAGCAL_FRAME_BYTES ? 1 : -1];

/* Where and when a sample comes from.
 * craft, source: 1 to 32 characters of A-Z a-z 0-9 _ -, the source unique within the craft.
 * sequence: counts the samples of one kind from this source; the daemon sees losses by it.
 * time_ns: time of the measurement [ns] since 1970-01-01 UTC (leap seconds ignored), or since the source's start.
 * clock: which of the two, MAGCAL_CLOCK_UTC or MAGCAL_CLOCK_ELAPSED. */
typedef struct {
    const char *craft;
    const char *source;
    uint32_t sequence;
    int64_t time_ns;
    int clock;
} magcal_origin;

/* A frame being written: the bytes before COBS stand so far behind the frame's start that COBS can work in place. */
typedef struct {
    uint8_t *frame;
    uint8_t *bytes;
    size_t size;
    size_t capacity;
    int refused;
} magcal_writer;

static inline void magcal_put(magcal_writer *w, unsigned value) {
    if (w->size < w->capacity) {
        w->bytes[w->size++] = (uint8_t)(value & 0xFFu);
    } else {
        w->refused = 1;
    }
}

static inline void magcal_put_big_endian(magcal_writer *w, uint64_t value, int bytes) {
    while (bytes-- > 0) magcal_put(w, (unsigned)((value >> (8 * bytes)) & 0xFFu));
}

static inline void magcal_put_unsigned(magcal_writer *w, uint64_t value) {
    if (value < 0x80u) {
        magcal_put(w, (unsigned)value);
    } else if (value <= 0xFFu) {
        magcal_put(w, 0xCC);
        magcal_put_big_endian(w, value, 1);
    } else if (value <= 0xFFFFu) {
        magcal_put(w, 0xCD);
        magcal_put_big_endian(w, value, 2);
    } else if (value <= 0xFFFFFFFFu) {
        magcal_put(w, 0xCE);
        magcal_put_big_endian(w, value, 4);
    } else {
        magcal_put(w, 0xCF);
        magcal_put_big_endian(w, value, 8);
    }
}

static inline void magcal_put_signed(magcal_writer *w, int64_t value) {
    const uint64_t bits = (uint64_t)value; /* two's complement, whatever the machine */
    if (value >= 0) {
        magcal_put_unsigned(w, bits);
    } else if (value >= -32) {
        magcal_put_big_endian(w, bits, 1);
    } else if (value >= INT8_MIN) {
        magcal_put(w, 0xD0);
        magcal_put_big_endian(w, bits, 1);
    } else if (value >= INT16_MIN) {
        magcal_put(w, 0xD1);
        magcal_put_big_endian(w, bits, 2);
    } else if (value >= INT32_MIN) {
        magcal_put(w, 0xD2);
        magcal_put_big_endian(w, bits, 4);
    } else {
        magcal_put(w, 0xD3);
        magcal_put_big_endian(w, bits, 8);
    }
}

/* The exponent is looked at in the bits, because -ffast-math lets a compiler drop comparisons with NaN. */
static inline void magcal_put_real(magcal_writer *w, magcal_real value) {
    magcal_bits bits;
    memcpy(&bits, &value, sizeof bits);
    if ((bits & MAGCAL_EXPONENT) == MAGCAL_EXPONENT) w->refused = 1;
    magcal_put(w, MAGCAL_REAL_MARK);
    magcal_put_big_endian(w, bits, (int)sizeof bits);
}

static inline void magcal_put_bounded(magcal_writer *w, magcal_real value, magcal_real low, magcal_real high) {
    magcal_put_real(w, value);
    if (value < low || value > high) w->refused = 1;
}

static inline void magcal_put_vector(magcal_writer *w, const magcal_real v[3], magcal_real limit) {
    int i;
    magcal_put(w, 0x93);
    for (i = 0; i < 3; i++) magcal_put_bounded(w, v[i], -limit, limit);
    if (!w->refused && v[0] * v[0] + v[1] * v[1] + v[2] * v[2] > limit * limit) w->refused = 1;
}

static inline int magcal_is_name_character(char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' || c == '-';
}

static inline void magcal_put_string(magcal_writer *w, const char *string, size_t length) {
    size_t i;
    if (length < 32) {
        magcal_put(w, 0xA0u + (unsigned)length);
    } else if (length < 256) {
        magcal_put(w, 0xD9);
        magcal_put(w, (unsigned)length);
    } else {
        magcal_put(w, 0xDA);
        magcal_put_big_endian(w, length, 2);
    }
    for (i = 0; i < length; i++) magcal_put(w, (unsigned char)string[i]);
}

static inline void magcal_put_name(magcal_writer *w, const char *name) {
    size_t length = 0;
    while (name != NULL && length <= MAGCAL_NAME_LENGTH && magcal_is_name_character(name[length])) length++;
    if (length == 0 || length > MAGCAL_NAME_LENGTH || name[length] != '\0') {
        w->refused = 1;
        return;
    }
    magcal_put_string(w, name, length);
}

/* Printable ASCII of up to `longest` bytes; the wire takes more, a board needs no table of Unicode. */
static inline void magcal_put_text(magcal_writer *w, const char *text, size_t longest) {
    size_t length = 0;
    while (text != NULL && length <= longest && text[length] >= ' ' && text[length] <= '~') length++;
    if (text == NULL || length > longest || text[length] != '\0') {
        w->refused = 1;
        return;
    }
    magcal_put_string(w, text, length);
}

/* The seven values that every message begins with; `length` counts all of the message's values, `before` the bytes
 * between the frame's header and the message. */
static inline void magcal_begin(magcal_writer *w, uint8_t *frame, size_t capacity, size_t before, int length, int kind,
                                const magcal_origin *origin) {
    const size_t shift = 2 + capacity / 254;
    w->frame = frame;
    w->refused = origin->clock != MAGCAL_CLOCK_UTC && origin->clock != MAGCAL_CLOCK_ELAPSED;
    w->size = MAGCAL_HEADER_BYTES + before;
    w->capacity = capacity > shift + 1 ? capacity - shift - 1 : 0;
    w->bytes = frame;
    if (w->capacity <= w->size) {
        w->refused = 1;
        return;
    }
    w->bytes += shift;
    magcal_put(w, 0x90u + (unsigned)length);
    magcal_put(w, MAGCAL_SCHEMA_VERSION);
    magcal_put(w, (unsigned)kind);
    magcal_put_name(w, origin->craft);
    magcal_put_name(w, origin->source);
    magcal_put_unsigned(w, origin->sequence);
    magcal_put_signed(w, origin->time_ns);
    magcal_put(w, (unsigned)origin->clock);
}

/* One step of CRC-32 of Ethernet and zlib, bit by bit: no table; begun with and finally inverted by 0xFFFFFFFF. */
static inline uint32_t magcal_crc32_step(uint32_t crc, uint8_t byte) {
    int bit;
    crc ^= byte;
    for (bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ ((crc & 1u) ? 0xEDB88320u : 0u);
    return crc;
}

static inline uint32_t magcal_crc32(const uint8_t *bytes, size_t size) {
    uint32_t crc = 0xFFFFFFFFu;
    while (size-- > 0) crc = magcal_crc32_step(crc, *bytes++);
    return crc ^ 0xFFFFFFFFu;
}

/* COBS between two delimiters; `bytes` may stand in the frame, 2 bytes and one for each 254 behind its start. */
static inline size_t magcal_stuff(uint8_t *frame, const uint8_t *bytes, size_t size) {
    size_t code_at = 1, at = 2, i;
    frame[0] = 0;
    for (i = 0; i < size; i++) {
        const uint8_t byte = bytes[i];
        if (byte != 0) frame[at++] = byte;
        if (byte == 0 || (at - code_at == 255 && i + 1 < size)) {
            frame[code_at] = (uint8_t)(at - code_at);
            code_at = at++;
        }
    }
    frame[code_at] = (uint8_t)(at - code_at);
    frame[at++] = 0;
    return at;
}

static inline size_t magcal_end(magcal_writer *w, uint16_t frame_sequence, int kind) {
    const size_t length = w->size - MAGCAL_HEADER_BYTES;
    uint32_t crc;
    int i;
    if (w->refused || length > MAGCAL_MAX_PAYLOAD_BYTES || w->capacity - w->size < MAGCAL_CRC_BYTES) return 0;
    w->bytes[0] = MAGCAL_FRAME_VERSION;
    w->bytes[1] = (uint8_t)kind;
    w->bytes[2] = (uint8_t)(frame_sequence & 0xFFu);
    w->bytes[3] = (uint8_t)(frame_sequence >> 8);
    w->bytes[4] = (uint8_t)(length & 0xFFu);
    w->bytes[5] = (uint8_t)(length >> 8);
    crc = magcal_crc32(w->bytes, w->size);
    for (i = 0; i < MAGCAL_CRC_BYTES; i++) magcal_put(w, (unsigned)((crc >> (8 * i)) & 0xFFu));
    return magcal_stuff(w->frame, w->bytes, w->size);
}

/* A measured vector in the sensor's own axes [nT].  `frame_sequence` counts all frames on this line. */
static inline size_t magcal_magnetometer(uint8_t frame[MAGCAL_FRAME_BYTES], uint16_t frame_sequence,
                                         const magcal_origin *origin, const magcal_real field_body_nt[3]) {
    magcal_writer w;
    magcal_begin(&w, frame, MAGCAL_FRAME_BYTES, 0, MAGCAL_MAGNETOMETER_MOST, MAGCAL_KIND_MAGNETOMETER, origin);
    magcal_put_vector(&w, field_body_nt, (magcal_real)MAGCAL_FIELD_LIMIT_NT);
    return magcal_end(&w, frame_sequence, MAGCAL_KIND_MAGNETOMETER);
}

/* The reference field as a vector [nT] in `axes`: MAGCAL_ECI, MAGCAL_ECEF or MAGCAL_NED. */
static inline size_t magcal_reference_vector(uint8_t frame[MAGCAL_FRAME_BYTES], uint16_t frame_sequence,
                                             const magcal_origin *origin, const magcal_real field_nt[3], int axes) {
    magcal_writer w;
    magcal_begin(&w, frame, MAGCAL_FRAME_BYTES, 0, MAGCAL_REFERENCE_MOST, MAGCAL_KIND_REFERENCE, origin);
    magcal_put_vector(&w, field_nt, (magcal_real)MAGCAL_FIELD_LIMIT_NT);
    magcal_put(&w, (unsigned)axes);
    magcal_put(&w, 0xC0);
    if (axes < MAGCAL_ECI || axes > MAGCAL_NED) w.refused = 1;
    return magcal_end(&w, frame_sequence, MAGCAL_KIND_REFERENCE);
}

/* The magnitude of the reference field alone [nT], 0 or more. */
static inline size_t magcal_reference_magnitude(uint8_t frame[MAGCAL_FRAME_BYTES], uint16_t frame_sequence,
                                                const magcal_origin *origin, magcal_real magnitude_nt) {
    magcal_writer w;
    magcal_begin(&w, frame, MAGCAL_FRAME_BYTES, 0, MAGCAL_REFERENCE_MOST, MAGCAL_KIND_REFERENCE, origin);
    magcal_put(&w, 0xC0);
    magcal_put(&w, 0xC0);
    magcal_put_bounded(&w, magnitude_nt, 0, (magcal_real)MAGCAL_FIELD_LIMIT_NT);
    return magcal_end(&w, frame_sequence, MAGCAL_KIND_REFERENCE);
}

/* The craft's position from the Earth's centre [km] in `axes`: MAGCAL_ECI or MAGCAL_ECEF. */
static inline size_t magcal_position(uint8_t frame[MAGCAL_FRAME_BYTES], uint16_t frame_sequence,
                                     const magcal_origin *origin, const magcal_real position_km[3], int axes) {
    magcal_writer w;
    magcal_begin(&w, frame, MAGCAL_FRAME_BYTES, 0, MAGCAL_POSITION_MOST, MAGCAL_KIND_POSITION, origin);
    magcal_put_vector(&w, position_km, (magcal_real)MAGCAL_POSITION_LIMIT_KM);
    magcal_put(&w, (unsigned)axes);
    if (axes != MAGCAL_ECI && axes != MAGCAL_ECEF) w.refused = 1;
    return magcal_end(&w, frame_sequence, MAGCAL_KIND_POSITION);
}

/* One channel of telemetry, 1 to 16 values in its unit: "temperature" [degC], "gyro" [rad/s], "torquer" [A m2], ...
 * `capacity` is the frame's size; MAGCAL_TELEMETRY_FRAME_BYTES is enough for all. */
static inline size_t magcal_telemetry(uint8_t *frame, size_t capacity, uint16_t frame_sequence,
                                      const magcal_origin *origin, const char *channel, const char *unit,
                                      const magcal_real *values, size_t count) {
    const magcal_real limit = (magcal_real)MAGCAL_TELEMETRY_LIMIT;
    magcal_writer w;
    size_t i;
    if (count < 1 || count > MAGCAL_MAX_VALUES) return 0;
    magcal_begin(&w, frame, capacity, 0, MAGCAL_TELEMETRY_MOST, MAGCAL_KIND_TELEMETRY, origin);
    magcal_put_name(&w, channel);
    magcal_put_text(&w, unit, MAGCAL_UNIT_BYTES);
    if (count > 15) magcal_put_big_endian(&w, 0xDC00, 2);
    magcal_put(&w, count > 15 ? (unsigned)count : 0x90u + (unsigned)count);
    for (i = 0; i < count; i++) magcal_put_bounded(&w, values[i], -limit, limit);
    return magcal_end(&w, frame_sequence, MAGCAL_KIND_TELEMETRY);
}

enum { MAGCAL_IS_TEXT, MAGCAL_IS_NUMBER, MAGCAL_IS_INTEGER, MAGCAL_IS_TRUTH };

/* One argument of a command; `is` says which of the last three is meant (a truth is an integer, 0 or not). */
typedef struct {
    const char *name;
    int is;
    const char *text;
    magcal_real number;
    int64_t integer;
} magcal_argument;

static inline void magcal_put_argument(magcal_writer *w, const magcal_argument *argument) {
    magcal_put_name(w, argument->name);
    if (argument->is == MAGCAL_IS_TEXT) {
        magcal_put_text(w, argument->text, MAGCAL_ARGUMENT_TEXT_BYTES);
    } else if (argument->is == MAGCAL_IS_NUMBER) {
        magcal_put_real(w, argument->number);
    } else if (argument->is == MAGCAL_IS_INTEGER) {
        magcal_put_signed(w, argument->integer);
    } else {
        magcal_put(w, argument->integer ? 0xC3 : 0xC2);
    }
}

static inline void magcal_put_command(magcal_writer *w, const char *name, const magcal_argument *arguments,
                                      size_t count) {
    size_t i, before;
    magcal_put_name(w, name);
    if (count > MAGCAL_MAX_ARGUMENTS) w->refused = 1;
    if (w->refused) return;
    magcal_put(w, 0x80u + (unsigned)count);
    for (i = 0; i < count && !w->refused; i++) {
        magcal_put_argument(w, &arguments[i]);
        for (before = 0; before < i && !w->refused; before++) {
            if (strcmp(arguments[before].name, arguments[i].name) == 0) w->refused = 1; /* each name once */
        }
    }
}

/* A command to the daemon, such as "status", "freeze", "resume" or "reset", with up to 8 arguments.
 * `capacity` is the frame's size: MAGCAL_COMMAND_FRAME_BYTES(number of arguments, their longest text). */
static inline size_t magcal_command(uint8_t *frame, size_t capacity, uint16_t frame_sequence,
                                    const magcal_origin *origin, const char *name, const magcal_argument *arguments,
                                    size_t count) {
    magcal_writer w;
    magcal_begin(&w, frame, capacity, 0, MAGCAL_COMMAND_MOST, MAGCAL_KIND_COMMAND, origin);
    magcal_put_command(&w, name, arguments, count);
    return magcal_end(&w, frame_sequence, MAGCAL_KIND_COMMAND);
}

#ifdef __cplusplus
}
#endif

#endif
