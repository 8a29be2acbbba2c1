/* board.h: a craft's board that feeds magcal and uses what comes back. */
#ifndef BOARD_H
#define BOARD_H

#include <stddef.h>
#include <stdint.h>

/* craft: its name in the daemon's configuration.
 * seconds: of the craft's time to run for.
 * speed: craft seconds per second; 0: as fast as the daemon answers.
 * noise: one byte in so many has a bit flipped, in both directions, as a bad cable would; 0: none.
 * key, key_size, counter: what commands are sealed with; key_size 0: they are not. */
typedef struct {
    const char *craft;
    long seconds;
    long speed;
    uint32_t noise;
    uint8_t key[64];
    size_t key_size;
    uint64_t counter;
} board_options;

/* Craft, seconds, speed and noise of up to 4 words (their defaults: demo, 60, 1, 0); 0 where one is refused, which stderr says. */
int board_read(board_options *options, int count, char **words);

/* The counter of a text; 0 where it is refused, which stderr says. */
int board_counter(const char *text, uint64_t *counter);

/* The key of a text in hexadecimal, of up to 64 bytes; its size, 0 where it is none. */
size_t board_key(const char *text, uint8_t key[64]);

/* Waits for the daemon, runs, prints a line each minute of the craft's time and the counts at the end; 0 where vectors came back. */
int board_run(const board_options *options);

#endif
