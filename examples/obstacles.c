/* What a camera in C hands over: a set of obstacles, byte by byte as shared memory has it.
 *
 *     cc -std=c11 -Wall -Wextra -I include examples/obstacles.c -lm -o obstacles
 *     ./obstacles 0.5 | xxd | head
 *
 * Writes the set of a time (s) to standard output: a ball on a circle, and a post. A client of iceoryx2 sends the same bytes under
 * the type name SINEW_OBSTACLES_TYPE_NAME, with source id, sequence and capture time of its own; python/tests/test_c.py has the
 * daemon take them.
 */
#include "sinew_payloads.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double CENTRE_M[3] = {0.40, -0.15, -1.68};
static const double CIRCLE_M = 0.32;
static const double RATE_RADPS = 0.1;

/* A place in the set, with what every obstacle has. */
static struct sinew_obstacle *add(struct sinew_obstacles *set, uint32_t kind) {
    struct sinew_obstacle *obstacle = &set->obstacles[set->count];
    memset(obstacle, 0, sizeof *obstacle);
    obstacle->id = ++set->count;
    obstacle->kind = kind;
    obstacle->quaternion[0] = 1.0;
    return obstacle;
}

static void look(struct sinew_obstacles *set, double time_s) {
    double angle = RATE_RADPS * time_s;
    struct sinew_obstacle *ball = add(set, SINEW_OBSTACLE_KIND_BALL);
    ball->position_m[0] = CENTRE_M[0] + CIRCLE_M * cos(angle);
    ball->position_m[1] = CENTRE_M[1] + CIRCLE_M * sin(angle);
    ball->position_m[2] = CENTRE_M[2];
    ball->velocity_mps[0] = -CIRCLE_M * RATE_RADPS * sin(angle);
    ball->velocity_mps[1] = CIRCLE_M * RATE_RADPS * cos(angle);
    ball->dimensions_m[0] = 0.1;
    struct sinew_obstacle *post = add(set, SINEW_OBSTACLE_KIND_CAPSULE);
    post->position_m[0] = -0.8;
    post->position_m[2] = -1.5;
    post->dimensions_m[0] = 0.7;
    post->dimensions_m[1] = 0.05;
}

int main(int argc, char **argv) {
    static struct sinew_obstacles set;
    set.header.schema_version = SINEW_SCHEMA_VERSION;
    set.header.tick = SINEW_NO_TICK;
    look(&set, argc > 1 ? strtod(argv[1], NULL) : 0.0);
    return fwrite(&set, sizeof set, 1, stdout) == 1 ? EXIT_SUCCESS : EXIT_FAILURE;
}
