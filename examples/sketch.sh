#!/bin/sh
# A calibration on a microcontroller: measure, export a C header, and compile it with a sketch.
set -eu

tiltcal measure cross-axis --sensor sca100t-d02 --address sim:seed=7 --serial S-0042 --jig 0.05 --operator sim -o S-0042.yaml
tiltcal export S-0042.yaml --to c -o tilt.h

cat >sketch.c <<'END'
#include <stdio.h>
#include "tilt.h"

int main(void) { /* on the controller: setup() and loop(), with the readings of the converter */
    float counts[TILT_CHANNELS], degrees[TILT_AXES];
    while (scanf("%f %f", &counts[0], &counts[1]) == 2) {
        tilt_degrees(counts, NAN, degrees); /* no thermometer */
        printf("%.1f %.1f\n", degrees[0], degrees[1]);
    }
    return 0;
}
END
${CC:-cc} -std=c99 -Wall -Werror -o sketch sketch.c -lm
printf '1024 1024\n1434 1024\n1024 614\n' | ./sketch
