/* posix.c: the board on a POSIX machine, at a serial device or a pseudo-terminal.
 *
 *     board DEVICE [CRAFT [SECONDS [SPEED [NOISE [KEYFILE COUNTER]]]]]
 *
 * `board --help` says what they are, and board.h what they become.
 */
#define _XOPEN_SOURCE 600
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "board.h"
#include "port.h"

#define USAGE "board DEVICE [CRAFT [SECONDS [SPEED [NOISE [KEYFILE COUNTER]]]]]\n"
#define HELP                                                                                         \
    "DEVICE   a serial device, or pty: makes a pseudo-terminal and prints its name for the daemon\n" \
    "CRAFT    its name in the daemon's configuration (demo)\n"                                       \
    "SECONDS  of the craft's time to run for (60)\n"                                                 \
    "SPEED    craft seconds per second; 0: as fast as the daemon answers (1)\n"                      \
    "NOISE    one byte in so many has a bit flipped, both ways; 0: none (0)\n"                       \
    "KEYFILE  the key that commands are sealed with, in hexadecimal, and COUNTER, the first to seal with\n"

static int line;
static struct timespec start;

int port_read(uint8_t *byte) {
    static uint8_t bytes[4096];
    static ssize_t size, at;
    if (at >= size) {
        size = read(line, bytes, sizeof bytes);
        at = 0;
    }
    if (size <= 0) return 0;
    *byte = bytes[at++];
    return 1;
}

void port_write(const uint8_t *bytes, size_t size) {
    while (size > 0) {
        const ssize_t written = write(line, bytes, size);
        struct pollfd ready = {0, POLLOUT, 0};
        if (written > 0) {
            bytes += written;
            size -= (size_t)written;
            continue;
        }
        ready.fd = line;
        if (poll(&ready, 1, 1000) <= 0) return; /* nobody takes it: as a UART would, go on */
    }
}

int64_t port_time_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)(now.tv_sec - start.tv_sec) * 1000000000 + (now.tv_nsec - start.tv_nsec);
}

void port_idle(void) {
    struct pollfd ready = {0, POLLIN, 0};
    ready.fd = line;
    if (poll(&ready, 1, 1) > 0 && (ready.revents & POLLIN) == 0) poll(NULL, 0, 1); /* the other end is not there */
}

static int open_line(const char *device) {
    struct termios raw;
    const int pair = strcmp(device, "pty") == 0;
    const int fd = pair ? posix_openpt(O_RDWR | O_NOCTTY) : open(device, O_RDWR | O_NOCTTY);
    if (fd < 0 || (pair && (grantpt(fd) != 0 || unlockpt(fd) != 0))) return -1;
    if (pair) {
        printf("line: %s\n", ptsname(fd));
        fflush(stdout);
    }
    if (tcgetattr(fd, &raw) == 0) {
        raw.c_iflag = raw.c_oflag = raw.c_lflag = 0;
        raw.c_cflag = CS8 | CREAD | CLOCAL;
        cfsetispeed(&raw, B115200);
        cfsetospeed(&raw, B115200);
        tcsetattr(fd, TCSANOW, &raw);
    }
    fcntl(fd, F_SETFL, O_NONBLOCK);
    return fd;
}

static size_t read_key(const char *path, uint8_t key[64]) {
    char text[129] = "";
    FILE *file = fopen(path, "r");
    if (file == NULL) return 0;
    if (fscanf(file, "%128s", text) != 1) text[0] = '\0';
    fclose(file);
    return board_key(text, key);
}

int main(int argc, char **argv) {
    static board_options options;
    if (argc > 1 && (strcmp(argv[1], "--help") == 0 || strcmp(argv[1], "-h") == 0)) {
        printf("usage: " USAGE HELP);
        return 0;
    }
    if (argc < 2 || argc == 7 || argc > 8) {
        fprintf(stderr, "%d arguments; accepted: " USAGE, argc - 1);
        return 2;
    }
    if (!board_read(&options, argc - 2, argv + 2)) return 2;
    if (argc > 7) {
        if (!board_counter(argv[7], &options.counter)) return 2;
        options.key_size = read_key(argv[6], options.key);
        if (options.key_size == 0) {
            fprintf(stderr, "%s: no key of 16 to 64 bytes in hexadecimal there\n", argv[6]);
            return 2;
        }
    }
    line = open_line(argv[1]);
    if (line < 0) {
        perror(argv[1]);
        return 2;
    }
    clock_gettime(CLOCK_MONOTONIC, &start);
    return board_run(&options);
}
