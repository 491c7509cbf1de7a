// Fuzzing without a foreign engine: inputs of the corpus are changed at random; what reaches new
// edges (gcc's -fsanitize-coverage=trace-pc) is kept and changed further. What crashes, hangs or
// leaks is written to a file. Built twice: with sanitizers, and without for many more executions.
#include "tests/fuzz/driver.h"

#include <dirent.h>
#include <errno.h>
#include <getopt.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#include "common/base/file.h"
#include "common/base/log.h"

#define EDGES (1u << 14)
#define MAX_INPUTS 20000
#define BATCH 64  // executions between looks at the clock
#define HANG_S 20 // of CPU, for a batch

const char *__asan_default_options(void);
const char *__asan_default_options(void) {
    return "allocator_may_return_null=1:max_allocation_size_mb=1024:handle_abort=1:"
           "detect_stack_use_after_return=0:quarantine_size_mb=1:malloc_context_size=4";
}
const char *__ubsan_default_options(void);
const char *__ubsan_default_options(void) {
    return "halt_on_error=1:print_stacktrace=1";
}
// libdav1d 1.0 keeps 40 bytes of each damaged AVIF; an import ends with its process.
const char *__lsan_default_suppressions(void);
const char *__lsan_default_suppressions(void) {
    return "leak:libdav1d\n";
}
// NULL in the build without sanitizers.
void __sanitizer_set_death_callback(void (*callback)(void)) __attribute__((weak));
int __lsan_do_recoverable_leak_check(void) __attribute__((weak));

// ---- coverage ---------------------------------------------------------------------------------

// How often this input took each edge, which ones it took, and what was seen so far.
static uint8_t hits[EDGES], seen[EDGES];
static uint32_t taken[EDGES];
static size_t taken_count;
static uintptr_t previous;

void __sanitizer_cov_trace_pc(void);
void __sanitizer_cov_trace_pc(void) {
    uintptr_t here = (uintptr_t)__builtin_return_address(0);
    here = (here >> 4) ^ (here << 9);
    uint32_t edge = (uint32_t)((here ^ previous) & (EDGES - 1));
    previous = here >> 1;
    uint8_t count = hits[edge];
    if (count == 0) taken[taken_count++] = edge;
    hits[edge] = (uint8_t)(count + (count < UINT8_MAX));
}

// Counts as their order of magnitude: 1, 2, 3, 4-7, 8-15, 16-31, 32-127, 128-.
static uint8_t magnitude(uint8_t count) {
    return count < 4     ? (uint8_t)(1u << count >> 1)
           : count < 8   ? 8
           : count < 16  ? 16
           : count < 32  ? 32
           : count < 128 ? 64
                         : 128;
}

// Whether the input took an edge as often as none before it; forgets what it took.
static bool is_new(void) {
    bool found = false;
    for (size_t i = 0; i < taken_count; i++) {
        uint8_t bit = magnitude(hits[taken[i]]), *known = &seen[taken[i]];
        found |= (bit & ~*known) != 0;
        *known |= bit;
        hits[taken[i]] = 0;
    }
    taken_count = 0;
    return found;
}

static unsigned edges(void) {
    unsigned count = 0;
    for (size_t i = 0; i < EDGES; i++)
        count += seen[i] != 0;
    return count;
}

// ---- inputs -----------------------------------------------------------------------------------

struct input {
    uint8_t *bytes;
    size_t size;
};
static struct input inputs[MAX_INPUTS];
static size_t input_count;
static struct input now;
static uint8_t *wall; // a page that nobody may read or write; inputs end before it
static const struct target *target;
static const char *found_folder = ".";
static uint64_t state = 1;

static uint64_t draw(void) {
    state ^= state << 13;
    state ^= state >> 7;
    return state ^= state << 17;
}

static size_t below(size_t most) {
    return most > 0 ? (size_t)(draw() % most) : 0;
}

static void add_input(const uint8_t *bytes, size_t size) {
    if (input_count == MAX_INPUTS) return;
    uint8_t *copy = malloc(size + 1);
    if (copy == NULL) abort();
    memcpy(copy, bytes, size);
    inputs[input_count++] = (struct input){copy, size};
}

static void keep_file(const char *folder, const char *prefix) {
    char path[4096];
    uint64_t hash = 1469598103934665603ull;
    for (size_t i = 0; i < now.size; i++)
        hash = (hash ^ now.bytes[i]) * 1099511628211ull;
    snprintf(path, sizeof path, "%s/%s-%s-%016llx", folder, prefix, target->name,
             (unsigned long long)hash);
    FILE *file = fopen(path, "wb");
    if (file == NULL || fwrite(now.bytes, 1, now.size, file) != now.size) perror(path);
    if (file != NULL) fclose(file);
    fprintf(stderr, "%s: %s\n", target->name, path);
}

static void on_death(void) {
    if (now.bytes != NULL) keep_file(found_folder, "crash");
}

// Without sanitizers: a crash, or undefined behaviour, which traps.
static void on_crash(int number) {
    signal(number, SIG_DFL);
    on_death();
    raise(number);
}

static void on_hang(int number) {
    static const char text[] = "fuzz: an input takes too long\n";
    if (write(2, text, sizeof text - 1) < 0) _exit(3);
    if (now.bytes != NULL) keep_file(found_folder, "hang");
    _exit(3);
}

void wrong(const char *what) {
    fprintf(stderr, "fuzz: %s\n", what);
    abort();
}

// ---- changing ---------------------------------------------------------------------------------

static void insert(struct input *input, size_t at, const uint8_t *bytes, size_t size) {
    if (input->size + size > target->max_size) return;
    memmove(input->bytes + at + size, input->bytes + at, input->size - at);
    memcpy(input->bytes + at, bytes, size);
    input->size += size;
}

static void cut(struct input *input, size_t at, size_t size) {
    memmove(input->bytes + at, input->bytes + at + size, input->size - at - size);
    input->size -= size;
}

static void change_number(struct input *input, size_t at) {
    static const int64_t numbers[] = {0,         1,     -1,     127,     128,        255,
                                      256,       32767, 65535,  65536,   2147483647, 2147483648,
                                      -2,        16,    999999, 1 << 24, 4294967295, INT64_MAX,
                                      INT64_MIN, 1024,  3};
    int64_t number = numbers[below(sizeof numbers / sizeof numbers[0])];
    size_t size = (size_t)1 << below(4);
    if (draw() & 1) {
        char text[32];
        size_t digits = 0;
        while (at + digits < input->size && strchr("0123456789.-+eE", input->bytes[at + digits]))
            digits++;
        int length =
            snprintf(text, sizeof text, draw() & 3 ? "%lld" : "%llde30", (long long)number);
        cut(input, at, digits);
        insert(input, at, (uint8_t *)text, (size_t)length);
    } else if (at + size <= input->size) {
        memcpy(input->bytes + at, &number, size);
    }
}

static void change(struct input *input) {
    static const char *const words[] = {
        "null", "true",  "[]",  "{}",           "\"\"", "[[", "\"a\":", "\\u0000",
        "\xff", "../",   "/",   "\n",           " ",    "-",  "nan",    "1e999",
        "0.5",  "\"},{", "%00", "\xe2\x80\xae", "\r\n", ",",  ":"};
    const struct input *other = &inputs[below(input_count)];
    size_t at = below(input->size + 1), left = input->size - at;
    switch (below(10)) {
    case 0:
        if (left > 0) input->bytes[at] ^= (uint8_t)(1u << below(8));
        break;
    case 1:
        if (left > 0) input->bytes[at] = (uint8_t)draw();
        break;
    case 2:
        if (left > 0) cut(input, at, 1 + below(left < 64 ? left : 64));
        break;
    case 3:
        if (left > 0) cut(input, at, 1 + below(left));
        break;
    case 4: {
        const char *word = words[below(sizeof words / sizeof words[0])];
        insert(input, at, (const uint8_t *)word, strlen(word));
        break;
    }
    case 5:
    case 6:
        change_number(input, at);
        break;
    case 7: { // again
        uint8_t copy[256];
        size_t size = left > 0 ? 1 + below(left < sizeof copy ? left : sizeof copy) : 0;
        memcpy(copy, input->bytes + at, size);
        for (size_t i = 1 + below(8); i > 0; i--)
            insert(input, at, copy, size);
        break;
    }
    case 8: { // a part of another
        size_t from = below(other->size + 1), size = other->size - from;
        if (size > 0) insert(input, at, other->bytes + from, 1 + below(size));
        break;
    }
    case 9: { // the end of another
        size_t from = below(other->size + 1);
        input->size = at;
        insert(input, at, other->bytes + from, other->size - from);
        break;
    }
    }
}

static void run_now(void) {
    uint8_t *bytes = wall - now.size - 1;
    previous = 0;
    memcpy(bytes, now.bytes, now.size);
    bytes[now.size] = '\0';
    target->run(bytes, now.size);
}

// Of three drawn the smallest, as a rule: a small input is changed where it matters, and is quick.
static const struct input *choose(void) {
    const struct input *chosen = NULL;
    for (int i = 0; i < 3; i++) {
        size_t at = draw() & 1 ? below(input_count) : input_count - 1 - below(input_count / 4 + 1);
        if (chosen == NULL || inputs[at].size < chosen->size) chosen = &inputs[at];
    }
    return draw() & 3 ? chosen : &inputs[below(input_count)];
}

static void change_and_run(void) {
    const struct input *from = choose();
    now.size = from->size < target->max_size ? from->size : target->max_size;
    memcpy(now.bytes, from->bytes, now.size);
    for (size_t i = (size_t)1 << below(4); i > 0; i--)
        change(&now);
    run_now();
}

// ---- the program ------------------------------------------------------------------------------

static double seconds(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + (double)time.tv_nsec * 1e-9;
}

static char scratch_folder[64];

const char *scratch(void) {
    return scratch_folder;
}

static bool shown;

bool is_shown(void) {
    return shown;
}

bool is_thorough(void) {
    static unsigned turn;
    return __sanitizer_set_death_callback != NULL || turn++ % 16 == 0;
}

static void remove_scratch(void) {
    if (rn_remove_tree(scratch_folder, NULL) != RN_OK) perror(scratch_folder);
}

static void make_scratch(void) {
    bool memory = access("/dev/shm", W_OK) == 0;
    snprintf(scratch_folder, sizeof scratch_folder, "%s/fuzz-XXXXXX", memory ? "/dev/shm" : "/tmp");
    if (mkdtemp(scratch_folder) == NULL) exit(2);
    atexit(remove_scratch);
}

static void read_file(const char *path) {
    uint8_t *bytes = NULL;
    size_t size;
    if (rn_file_read(path, target->max_size, &bytes, &size, NULL) == RN_OK) add_input(bytes, size);
    free(bytes);
}

// CORPUS/TARGET; a part of the name before a dash serves for all that begin with it.
static void read_corpus(const char *corpus) {
    char folder[4096], path[8192];
    struct dirent **entries = NULL;
    snprintf(folder, sizeof folder, "%s/%s", corpus, target->name);
    int count = scandir(folder, &entries, NULL, alphasort);
    for (int i = 0; i < count; i++) {
        snprintf(path, sizeof path, "%s/%s", folder, entries[i]->d_name);
        if (entries[i]->d_name[0] != '.') read_file(path);
        free(entries[i]);
    }
    free(entries);
}

static void make_wall(void) {
    size_t page = (size_t)sysconf(_SC_PAGESIZE);
    size_t size = (target->max_size + page) / page * page;
    uint8_t *room =
        mmap(NULL, size + page, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (room == MAP_FAILED || mprotect(room + size, page, PROT_NONE) != 0) exit(2);
    wall = room + size;
}

static void catch_faults(void) {
    static const int signals[] = {SIGSEGV, SIGBUS, SIGILL, SIGTRAP, SIGFPE, SIGABRT};
    static char stack[1 << 16];
    const stack_t own = {.ss_sp = stack, .ss_size = sizeof stack};
    struct sigaction action = {.sa_handler = on_crash, .sa_flags = SA_ONSTACK};
    signal(SIGPROF, on_hang);
    if (__sanitizer_set_death_callback != NULL) {
        __sanitizer_set_death_callback(on_death);
        return;
    }
    if (sigaltstack(&own, NULL) != 0) exit(2);
    for (size_t i = 0; i < sizeof signals / sizeof signals[0]; i++)
        sigaction(signals[i], &action, NULL);
}

static void begin_batch(void) {
    const struct itimerval patience = {.it_value.tv_sec = HANG_S};
    setitimer(ITIMER_PROF, &patience, NULL);
}

static int usage(void) {
    fprintf(stderr, "usage: fuzz --list\n"
                    "       fuzz TARGET --corpus DIR [--seconds S] [--runs N] [--seed N]\n"
                    "                   [--keep DIR] [--found DIR]\n"
                    "       fuzz TARGET --input FILE\n");
    return 2;
}

static unsigned long long fuzz(double limit_s, unsigned long long most, const char *keep) {
    unsigned long long runs = 0;
    double end = seconds() + limit_s;
    const uint8_t nothing = 0;
    if (input_count == 0) add_input(&nothing, 0);
    for (size_t i = 0; i < input_count; i++, runs++) {
        begin_batch();
        now.size = inputs[i].size;
        memcpy(now.bytes, inputs[i].bytes, now.size);
        run_now();
        (void)is_new();
    }
    for (size_t i = 0; runs < most && (i % BATCH != 0 || seconds() < end); i++, runs++) {
        if (i % BATCH == 0) begin_batch();
        change_and_run();
        if (!is_new()) continue;
        add_input(now.bytes, now.size);
        if (keep != NULL) keep_file(keep, "new");
    }
    return runs;
}

int main(int argc, char **argv) {
    static const struct option options[] = {{"list", no_argument, NULL, 'l'},
                                            {"corpus", required_argument, NULL, 'c'},
                                            {"seconds", required_argument, NULL, 's'},
                                            {"runs", required_argument, NULL, 'n'},
                                            {"seed", required_argument, NULL, 'r'},
                                            {"keep", required_argument, NULL, 'k'},
                                            {"found", required_argument, NULL, 'f'},
                                            {"input", required_argument, NULL, 'i'},
                                            {NULL, 0, NULL, 0}};
    const char *corpus = NULL, *keep = NULL, *input = NULL;
    double limit_s = 1e9;
    unsigned long long most = ~0ull;
    int option;
    while ((option = getopt_long(argc, argv, "", options, NULL)) != -1) {
        if (option == 'l') {
            for (const struct target *at = targets; at->name != NULL; at++)
                puts(at->name);
            return 0;
        }
        if (option == 'c') corpus = optarg;
        if (option == 's') limit_s = strtod(optarg, NULL);
        if (option == 'n') most = strtoull(optarg, NULL, 10);
        if (option == 'r') state = strtoull(optarg, NULL, 10) * 2654435761ull + 1;
        if (option == 'k') keep = optarg;
        if (option == 'f') found_folder = optarg;
        if (option == 'i') input = optarg;
        if (option == '?') return usage();
    }
    if (optind + 1 != argc) return usage();
    for (target = targets; target->name != NULL && strcmp(target->name, argv[optind]) != 0;)
        target++;
    if (target->name == NULL || (corpus == NULL && input == NULL)) return usage();
    rn_log_set_level(RN_LOG_ERROR);
    make_scratch();
    now.bytes = malloc(target->max_size + 65536);
    if (now.bytes == NULL) return 2;
    make_wall();
    catch_faults();
    if (input != NULL) {
        read_file(input);
        most = 1;
        shown = true;
    } else {
        read_corpus(corpus);
    }
    double begin = seconds();
    unsigned long long runs = fuzz(limit_s, most, keep);
    bool leaks =
        __lsan_do_recoverable_leak_check != NULL && __lsan_do_recoverable_leak_check() != 0;
    printf("%s: %llu executions in %.1f s, %zu inputs, %u edges%s\n", target->name, runs,
           seconds() - begin, input_count, edges(), leaks ? ", LEAKS" : "");
    return leaks ? 1 : 0;
}
