/* port.h: what board.c needs of the machine it runs on. */
#ifndef PORT_H
#define PORT_H

#include <stddef.h>
#include <stdint.h>

/* The next byte from the line; 0 where none is there.  Waits for nothing. */
int port_read(uint8_t *byte);

/* All bytes onto the line, as soon as it takes them. */
void port_write(const uint8_t *bytes, size_t size);

/* Time since the start [ns]. */
int64_t port_time_ns(void);

/* Sleeps until a byte comes, or about a millisecond; may do nothing. */
void port_idle(void);

#endif
