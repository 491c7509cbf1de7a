// What the driver and the targets of the fuzzer share.
#ifndef RN_TESTS_FUZZ_DRIVER_H
#define RN_TESTS_FUZZ_DRIVER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

// A parser under test: takes any bytes, and must end without a crash, a leak, a hang or an answer
// that its own check refuses. The bytes are followed by a NUL that does not count.
struct target {
    const char *name;
    void (*run)(const uint8_t *bytes, size_t size);
    size_t max_size;
};
// Ends with a name of NULL. targets.c
extern const struct target targets[];

// A folder of this process's own, for targets that read files; removed at the end.
const char *scratch(void);
// Whether one input is shown: refusals are printed.
bool is_shown(void);
// Whether a check that takes longer than the parser is due: always with sanitizers, else for one
// in 16.
bool is_thorough(void);
// An answer that must not be: prints it, keeps the input and ends.
void wrong(const char *what);

#endif
