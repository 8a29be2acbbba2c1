/* magcal_seal.h: commands sealed with a key, for a line that anybody could write to (docs/wire.md, "Sealed commands").
 *
 * C99, no allocation.  SHA-256 is FIPS 180-4, HMAC is RFC 2104; about 200 bytes of stack.
 *
 * The counter must be above all counters that were ever sealed with this key: keep it where a reset does not lose it,
 * or take the larger of the last one plus 1 and the UNIX time in microseconds, as magcal does.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef MAGCAL_SEAL_H
#define MAGCAL_SEAL_H

#include "magcal_encode.h"

#ifdef __cplusplus
extern "C" {
#endif

#define MAGCAL_KEY_LEAST 16
#define MAGCAL_KEY_MOST 64
#define MAGCAL_COUNTER_BYTES 8

typedef struct {
    uint32_t state[8];
    uint8_t block[64];
    uint64_t size;
} magcal_sha256;

static inline uint32_t magcal_rotated(uint32_t x, int n) { return (x >> n) | (x << (32 - n)); }

static inline void magcal_sha256_block(magcal_sha256 *h) {
    static const uint32_t k[64] = {
        0x428a2f98u, 0x71374491u, 0xb5c0fbcfu, 0xe9b5dba5u, 0x3956c25bu, 0x59f111f1u, 0x923f82a4u, 0xab1c5ed5u,
        0xd807aa98u, 0x12835b01u, 0x243185beu, 0x550c7dc3u, 0x72be5d74u, 0x80deb1feu, 0x9bdc06a7u, 0xc19bf174u,
        0xe49b69c1u, 0xefbe4786u, 0x0fc19dc6u, 0x240ca1ccu, 0x2de92c6fu, 0x4a7484aau, 0x5cb0a9dcu, 0x76f988dau,
        0x983e5152u, 0xa831c66du, 0xb00327c8u, 0xbf597fc7u, 0xc6e00bf3u, 0xd5a79147u, 0x06ca6351u, 0x14292967u,
        0x27b70a85u, 0x2e1b2138u, 0x4d2c6dfcu, 0x53380d13u, 0x650a7354u, 0x766a0abbu, 0x81c2c92eu, 0x92722c85u,
        0xa2bfe8a1u, 0xa81a664bu, 0xc24b8b70u, 0xc76c51a3u, 0xd192e819u, 0xd6990624u, 0xf40e3585u, 0x106aa070u,
        0x19a4c116u, 0x1e376c08u, 0x2748774cu, 0x34b0bcb5u, 0x391c0cb3u, 0x4ed8aa4au, 0x5b9cca4fu, 0x682e6ff3u,
        0x748f82eeu, 0x78a5636fu, 0x84c87814u, 0x8cc70208u, 0x90befffau, 0xa4506cebu, 0xbef9a3f7u, 0xc67178f2u};
    uint32_t w[16], s[8];
    int t;
    memcpy(s, h->state, sizeof s);
    for (t = 0; t < 64; t++) {
        const int at = t & 15;
        uint32_t t1, t2;
        if (t < 16) {
            const uint8_t *b = &h->block[4 * t];
            w[at] = (uint32_t)b[0] << 24 | (uint32_t)b[1] << 16 | (uint32_t)b[2] << 8 | b[3];
        } else {
            const uint32_t w2 = w[(t - 2) & 15], w15 = w[(t - 15) & 15];
            w[at] += (magcal_rotated(w2, 17) ^ magcal_rotated(w2, 19) ^ (w2 >> 10)) + w[(t - 7) & 15] +
                     (magcal_rotated(w15, 7) ^ magcal_rotated(w15, 18) ^ (w15 >> 3));
        }
        t1 = s[7] + (magcal_rotated(s[4], 6) ^ magcal_rotated(s[4], 11) ^ magcal_rotated(s[4], 25)) +
             ((s[4] & s[5]) ^ (~s[4] & s[6])) + k[t] + w[at];
        t2 = (magcal_rotated(s[0], 2) ^ magcal_rotated(s[0], 13) ^ magcal_rotated(s[0], 22)) +
             ((s[0] & s[1]) ^ (s[0] & s[2]) ^ (s[1] & s[2]));
        memmove(&s[1], &s[0], 7 * sizeof s[0]);
        s[4] += t1;
        s[0] = t1 + t2;
    }
    for (t = 0; t < 8; t++) h->state[t] += s[t];
}

static inline void magcal_sha256_begin(magcal_sha256 *h) {
    static const uint32_t start[8] = {0x6a09e667u, 0xbb67ae85u, 0x3c6ef372u, 0xa54ff53au,
                                      0x510e527fu, 0x9b05688cu, 0x1f83d9abu, 0x5be0cd19u};
    memcpy(h->state, start, sizeof start);
    h->size = 0;
}

static inline void magcal_sha256_add(magcal_sha256 *h, const uint8_t *bytes, size_t size) {
    while (size-- > 0) {
        h->block[h->size++ & 63u] = *bytes++;
        if ((h->size & 63u) == 0) magcal_sha256_block(h);
    }
}

static inline void magcal_sha256_end(magcal_sha256 *h, uint8_t digest[32]) {
    const uint64_t bits = 8 * h->size;
    static const uint8_t one = 0x80, zero = 0;
    uint8_t length[8];
    int i;
    magcal_sha256_add(h, &one, 1);
    while ((h->size & 63u) != 56) magcal_sha256_add(h, &zero, 1);
    for (i = 0; i < 8; i++) length[i] = (uint8_t)(bits >> (56 - 8 * i));
    magcal_sha256_add(h, length, 8);
    for (i = 0; i < 32; i++) digest[i] = (uint8_t)(h->state[i / 4] >> (24 - 8 * (i % 4)));
}

static inline void magcal_hmac_key(magcal_sha256 *h, const uint8_t *key, size_t key_size, uint8_t pad) {
    size_t i;
    magcal_sha256_begin(h);
    for (i = 0; i < 64; i++) {
        const uint8_t byte = (uint8_t)((i < key_size ? key[i] : 0) ^ pad);
        magcal_sha256_add(h, &byte, 1);
    }
}

/* The seal's tag over label, counter and payload; a key of at most 64 bytes. */
static inline void magcal_tag(const uint8_t *key, size_t key_size, const uint8_t *content, size_t size,
                              uint8_t tag[MAGCAL_TAG_BYTES]) {
    static const char label[24] = MAGCAL_SEAL_LABEL; /* its last byte is the 00 */
    magcal_sha256 h;
    uint8_t digest[32];
    magcal_hmac_key(&h, key, key_size, 0x36);
    magcal_sha256_add(&h, (const uint8_t *)label, sizeof label);
    magcal_sha256_add(&h, content, size);
    magcal_sha256_end(&h, digest);
    magcal_hmac_key(&h, key, key_size, 0x5C);
    magcal_sha256_add(&h, digest, sizeof digest);
    magcal_sha256_end(&h, digest);
    memcpy(tag, digest, MAGCAL_TAG_BYTES);
}

/* A command as `magcal_command`, sealed; `counter` from 1.  0 also for a key that is not of 16 to 64 bytes. */
static inline size_t magcal_sealed_command(uint8_t *frame, size_t capacity, uint16_t frame_sequence,
                                           const magcal_origin *origin, const char *name,
                                           const magcal_argument *arguments, size_t count, const uint8_t *key,
                                           size_t key_size, uint64_t counter) {
    magcal_writer w;
    uint8_t tag[MAGCAL_TAG_BYTES];
    size_t i;
    if (key_size < MAGCAL_KEY_LEAST || key_size > MAGCAL_KEY_MOST || counter == 0) return 0;
    magcal_begin(&w, frame, capacity, MAGCAL_COUNTER_BYTES, MAGCAL_COMMAND_MOST, MAGCAL_KIND_COMMAND, origin);
    magcal_put_command(&w, name, arguments, count);
    if (w.refused) return 0;
    for (i = 0; i < MAGCAL_COUNTER_BYTES; i++) w.bytes[MAGCAL_HEADER_BYTES + i] = (uint8_t)(counter >> (8 * i));
    magcal_tag(key, key_size, &w.bytes[MAGCAL_HEADER_BYTES], w.size - MAGCAL_HEADER_BYTES, tag);
    for (i = 0; i < MAGCAL_TAG_BYTES; i++) magcal_put(&w, tag[i]);
    return magcal_end(&w, frame_sequence, MAGCAL_KIND_COMMAND | MAGCAL_SEALED);
}

#ifdef __cplusplus
}
#endif

#endif
