#!/bin/sh
# The README's table: bytes of code and constants that each part of the kit adds to a program, linked at -Os without
# start code, and the bytes of memory that the decoder, one message and 2048 bytes held take; for every target whose
# compiler is there.  After the plus: the compiler's and C library (64-bit and floating-point arithmetic, strings,
# mathematics), which firmware mostly has already.
set -eu
cd "$(dirname "$0")/.."
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

# linked COMPILER FLAGS... : bytes of text and data, and of bss
linked() {
    "$@" -std=c99 -Os -ffunction-sections -fdata-sections -I. sizes/sizes.c -nostartfiles -Wl,--gc-sections,-e,entry \
        -lm -o "$folder/linked" 2>"$folder/log" || { cat "$folder/log" >&2; return 1; }
    size "$folder/linked" | awk 'NR == 2 {print $1 + $2}'
}

memory() {
    "$@" -std=c99 -Os -I. -c sizes/sizes.c -o "$folder/alone.o"
    size "$folder/alone.o" | awk 'NR == 2 {print $3}'
}

alone() {
    "$@" -std=c99 -Os -I. -c sizes/sizes.c -o "$folder/alone.o"
    size "$folder/alone.o" | awk 'NR == 2 {print $1 + $2}'
}

# row TARGET COMPILER FLAGS...
row() {
    target=$1
    shift
    command -v "$1" >/dev/null || { printf '%-34s | no %s here\n' "| $target" "$1"; return 0; }
    none=$(linked "$@" -DPART=0)
    bare=$(alone "$@" -DPART=0)
    printf '%-34s |' "| $target"
    for part in 1 2 3 4 5; do
        own=$(($(alone "$@" -DPART=$part) - bare))
        printf ' %5d + %5d |' "$own" $(($(linked "$@" -DPART=$part) - none - own))
    done
    printf ' %6d |\n' $(($(memory "$@" -DPART=4) - $(memory "$@" -DPART=1)))
}

echo '| target | samples out | all kinds out | samples, sealed commands | samples, decoder, apply | IGRF | memory |'
echo '|---|---|---|---|---|---|---|'
arm="arm-none-eabi-gcc --specs=nano.specs --specs=nosys.specs -mthumb"
row 'Cortex-M0' $arm -mcpu=cortex-m0
row 'Cortex-M4' $arm -mcpu=cortex-m4
row 'Cortex-M4F, single precision' $arm -mcpu=cortex-m4 -mfpu=fpv4-sp-d16 -mfloat-abi=hard -DMAGCAL_SINGLE_PRECISION
row 'Cortex-M7, double precision' $arm -mcpu=cortex-m7 -mfpu=fpv5-d16 -mfloat-abi=hard
row 'AVR ATmega328P, single precision' avr-gcc -mmcu=atmega328p -DMAGCAL_SINGLE_PRECISION
row "this machine ($(uname -m))" cc
