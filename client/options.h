// Command lines: options by table, anywhere among the arguments.
#ifndef RN_CLIENT_OPTIONS_H
#define RN_CLIENT_OPTIONS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "common/base/status.h"
#include "common/settings/setting.h"

// What an option's field is and what it accepts.
enum rn_option_kind {
    RN_OPTION_FLAG,    // bool; takes no value
    RN_OPTION_TEXT,    // const char *, NULL when absent; points into argv
    RN_OPTION_CHOICE,  // as TEXT, one of `choices`
    RN_OPTION_INTEGER, // int64_t in [min, max], RN_OPTION_ABSENT when absent
    RN_OPTION_NUMBER,  // double in [min, max], NAN when absent
    RN_OPTION_SECONDS, // as NUMBER; "90", "60s", "10m", "1.5h"
    RN_OPTION_BYTES,   // as NUMBER; "4096", "40M", "2G": units of 1024
    RN_OPTION_SIZE,    // struct rn_option_pair, "WxH"
    RN_OPTION_RANGE,   // struct rn_option_pair, "A-B" with A <= B, or "A"
    // In a table: an option for each row of `settings` that has a flag, in its place in a
    // union rn_setting_value[settings->count] at `offset`; absent as rn_setting_absent says.
    RN_OPTION_SETTINGS,
};

#define RN_OPTION_ABSENT INT64_MIN

struct rn_option_pair {
    int64_t first, second; // RN_OPTION_ABSENT when absent
};

// A table of them ends with a NULL name; SETTINGS have any, "".
struct rn_option {
    const char *name; // without the dashes
    char letter;      // "-o", 0 for none
    enum rn_option_kind kind;
    size_t offset;                             // of the field in the options' struct
    const char *value;                         // the value's name in the usage
    const char *help;                          // one line
    double min, max;                           // of numbers, and of both numbers of a pair
    const char *const *choices;                // names, as a table has them; NULL ends
    void (*list)(char *text, size_t capacity); // writes "a|b|c", where they are no list of names
    const struct rn_settings *settings;
    const char *needs;   // an option of the table without which this one says nothing; NULL: none
    const char *members; // of requests, "first|last"; NULL: the name with '_' for '-'
};
#define RN_CHOICES_MAX 256
// "a|b|c"; "" where there are none, or names is NULL. Returns its length.
size_t rn_choices_join(const char *const *names, char ret_text[RN_CHOICES_MAX]);
// The option's choices so, in `room`; NULL where it has none.
const char *rn_option_choices(const struct rn_option *option, char room[RN_CHOICES_MAX]);

// Fills `options` (the struct that the table's offsets mean, of size_bytes) and `globals` (that of
// global_table) from the arguments, and gathers the others in ret_args, which has room for
// arg_max + 1 and ends with NULL. "--" ends the options. RN_ERROR_INVALID names the option, also
// one that is given without what it needs.
struct rn_option_tables {
    const struct rn_option *table, *global_table;
    void *options, *globals;
};
enum rn_status rn_options_parse(const struct rn_option_tables *tables, int argc, char **argv,
                                size_t arg_max, const char **ret_args, size_t *ret_arg_count,
                                struct rn_error *err) RN_MUST_CHECK;

// The option behind a member of a request, the last word of the JSON pointer that a daemon's
// problem names: "#/options/last" is "--frames". false where it is of no option.
bool rn_options_find_member(const struct rn_option *table, const char *pointer, char *ret_option,
                            size_t capacity);
// The name of an option that was given, into `ret_name`; false: none was.
bool rn_options_given(const struct rn_option *table, const void *options, char *ret_name,
                      size_t capacity);
// Sets every field of a table to "absent".
void rn_options_clear(const struct rn_option *table, void *options);
// Words of a text on stdout, wrapped to 80 columns and indented; the first one goes to `column`.
// Empty lines and lines that begin with a space are kept.
void rn_options_print_text(const char *text, int column, int indent);
// An option's name and meaning, on stdout, in 80 columns.
void rn_options_print(const struct rn_option *table);

#endif
