/* options.c: the words that a board is started with, refused where they are no value of theirs. */
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>

#include "board.h"
#include "magcal.h"

#define LONGEST_S 10000000 /* 116 days; the samples' sequence numbers go to 429 */
#define FASTEST 1000000

/* 1 where all of `text` is a whole number from 0 on that 64 bits hold. */
static int whole(const char *text, uint64_t *value) {
    char *end;
    if (*text < '0' || *text > '9') return 0;
    errno = 0;
    *value = strtoull(text, &end, 10);
    return *end == '\0' && errno == 0;
}

static int number(const char *name, const char *text, unsigned long least, unsigned long most, uint64_t *value) {
    if (whole(text, value) && *value >= least && *value <= most) return 1;
    fprintf(stderr, "%s '%s': a whole number from %lu to %lu is accepted\n", name, text, least, most);
    return 0;
}

static int is_name(const char *text) {
    size_t size = 0;
    while (magcal_is_name_character(text[size])) size++;
    return size >= 1 && size <= MAGCAL_NAME_LENGTH && text[size] == '\0';
}

int board_counter(const char *text, uint64_t *counter) {
    if (whole(text, counter)) return 1;
    fprintf(stderr, "COUNTER '%s': a whole number from 0 to 18446744073709551615 is accepted\n", text);
    return 0;
}

int board_read(board_options *options, int count, char **words) {
    uint64_t seconds = 60, speed = 1, noise = 0;
    options->craft = count > 0 ? words[0] : "demo";
    if (!is_name(options->craft)) {
        fprintf(stderr, "CRAFT '%s': 1 to %d characters of A-Z a-z 0-9 _ - are accepted\n", options->craft,
                (int)MAGCAL_NAME_LENGTH);
        return 0;
    }
    if (count > 1 && !number("SECONDS", words[1], 1, LONGEST_S, &seconds)) return 0;
    if (count > 2 && !number("SPEED", words[2], 0, FASTEST, &speed)) return 0;
    if (count > 3 && !number("NOISE", words[3], 0, UINT32_MAX, &noise)) return 0;
    options->seconds = (long)seconds;
    options->speed = (long)speed;
    options->noise = (uint32_t)noise;
    return 1;
}

static int digit(char c) {
    if (c >= '0' && c <= '9') return c - '0';
    if (c >= 'a' && c <= 'f') return c - 'a' + 10;
    return c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
}

size_t board_key(const char *text, uint8_t key[64]) {
    size_t size = 0;
    for (; size < 64 && digit(text[0]) >= 0 && digit(text[1]) >= 0; text += 2) {
        key[size++] = (uint8_t)(16 * digit(text[0]) + digit(text[1]));
    }
    return size >= MAGCAL_KEY_LEAST ? size : 0;
}
