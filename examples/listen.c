/* Prints slips as they are told, and when not to trust the sense of touch.
 *
 *     cc listen.c $(pkg-config --cflags --libs libtactiled) -o listen
 *     ./listen ipc:///run/tactiled/all/events.ipc
 */
#include <math.h>
#include <stdio.h>
#include <tactiled.h>

int main(int argc, char **argv)
{
    tactiled_client *events = tactiled_open(argc > 1 ? argv[1] : NULL, "slip", NULL, NULL);
    int kind = TACTILED_FAILED;
    while (events && (kind = tactiled_next(events, -1.0)) != TACTILED_FAILED) {
        double is_valid = 0.0;
        if (kind == TACTILED_STALE)
            printf("hold without touch: %s\n", tactiled_reason(events));
        if (kind == TACTILED_MESSAGE && tactiled_number(events, "valid", &is_valid) == 0 && is_valid != 0.0 &&
            tactiled_is_fresh(events) && fabs(tactiled_age_s(events)) < 0.2) {
            printf("%s of a slip, ", tactiled_text(events, "state"));
            printf("%s\n", tactiled_text(events, "kind"));
        }
        fflush(stdout);
    }
    fprintf(stderr, "listen: %s\n", tactiled_error());
    tactiled_close(events);
    return 1;
}
