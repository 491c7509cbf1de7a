#include "client/options.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/nearest.h"

#define KEYS_MAX 400

static void *field_of(const struct rn_option *option, void *options) {
    return (char *)options + option->offset;
}

void rn_options_clear(const struct rn_option *table, void *options) {
    for (const struct rn_option *option = table; option->name; option++) {
        void *field = field_of(option, options);
        switch (option->kind) {
        case RN_OPTION_FLAG:
            *(bool *)field = false;
            break;
        case RN_OPTION_TEXT:
        case RN_OPTION_CHOICE:
            *(const char **)field = NULL;
            break;
        case RN_OPTION_INTEGER:
            *(int64_t *)field = RN_OPTION_ABSENT;
            break;
        case RN_OPTION_NUMBER:
        case RN_OPTION_SECONDS:
        case RN_OPTION_BYTES:
            *(double *)field = NAN;
            break;
        case RN_OPTION_SIZE:
        case RN_OPTION_RANGE:
            *(struct rn_option_pair *)field =
                (struct rn_option_pair){RN_OPTION_ABSENT, RN_OPTION_ABSENT};
            break;
        case RN_OPTION_SETTINGS:
            for (size_t i = 0; i < option->settings->count; i++)
                ((union rn_setting_value *)field)[i] =
                    rn_setting_absent(&option->settings->rows[i]);
            break;
        }
    }
}

// The row of an option's settings that was given; NULL: none.
static const struct rn_setting *given_setting(const struct rn_option *option, const void *field) {
    const union rn_setting_value *values = field;
    for (size_t i = 0; i < option->settings->count; i++)
        if (!rn_setting_is_absent(&option->settings->rows[i], &values[i]))
            return &option->settings->rows[i];
    return NULL;
}

// The flag by which the option was given, without its dashes; NULL: it was not.
static const char *given(const struct rn_option *option, const void *options) {
    const void *field = (const char *)options + option->offset;
    const struct rn_setting *row;
    bool is = false;
    switch (option->kind) {
    case RN_OPTION_FLAG:
        is = *(const bool *)field;
        break;
    case RN_OPTION_TEXT:
    case RN_OPTION_CHOICE:
        is = *(const char *const *)field != NULL;
        break;
    case RN_OPTION_INTEGER:
        is = *(const int64_t *)field != RN_OPTION_ABSENT;
        break;
    case RN_OPTION_NUMBER:
    case RN_OPTION_SECONDS:
    case RN_OPTION_BYTES:
        is = !isnan(*(const double *)field);
        break;
    case RN_OPTION_SIZE:
    case RN_OPTION_RANGE:
        is = ((const struct rn_option_pair *)field)->first != RN_OPTION_ABSENT;
        break;
    case RN_OPTION_SETTINGS:
        row = given_setting(option, field);
        return row ? row->flag : NULL;
    }
    return is ? option->name : NULL;
}

bool rn_options_given(const struct rn_option *table, const void *options, char *ret_name,
                      size_t capacity) {
    const char *name = NULL;
    for (const struct rn_option *option = table; option->name && !name; option++)
        name = given(option, options);
    if (name) snprintf(ret_name, capacity, "--%s", name);
    return name;
}

static enum rn_status check_needs(const struct rn_option *table, const void *options,
                                  struct rn_error *err) {
    for (const struct rn_option *option = table; option->name; option++) {
        const char *name = option->needs ? given(option, options) : NULL;
        const struct rn_option *other = table;
        while (name && strcmp(other->name, option->needs) != 0)
            other++; // which is there
        if (!name || given(other, options)) continue;
        char where[64];
        snprintf(where, sizeof where, "--%s", name);
        return rn_error_set(err, RN_ERROR_INVALID, where, "says nothing without --%s",
                            option->needs);
    }
    return RN_OK;
}

// An integer of the option's range that ends where `end` says (a NUL or a separator).
static bool parse_integer(const struct rn_option *option, const char *text, char end,
                          int64_t *ret_value, const char **ret_rest) {
    char *rest = NULL;
    if (*text < '0' || *text > '9') return false;
    errno = 0;
    long long value = strtoll(text, &rest, 10);
    if (errno || *rest != end || (double)value < option->min || (double)value > option->max)
        return false;
    *ret_value = value;
    *ret_rest = rest + 1;
    return true;
}

static bool parse_number(const struct rn_option *option, const char *text, double *ret_value) {
    char *rest = NULL;
    double value = strtod(text, &rest);
    if (rest == text) return false;
    if (option->kind == RN_OPTION_SECONDS && *rest && strchr("smh", *rest))
        value *= *rest == 'h' ? 3600 : *rest == 'm' ? 60 : 1, rest++;
    static const char units[] = "KMGT";
    const char *unit = *rest ? strchr(units, *rest) : NULL;
    if (option->kind == RN_OPTION_BYTES && unit)
        value = ldexp(value, 10 * (int)(unit - units + 1)), rest++;
    if (*rest || !(value >= option->min && value <= option->max)) return false;
    *ret_value = value;
    return true;
}

static bool parse_pair(const struct rn_option *option, const char *text,
                       struct rn_option_pair *ret_pair) {
    struct rn_option_pair pair = {0};
    const char *rest = NULL;
    char separator = option->kind == RN_OPTION_SIZE ? 'x' : '-';
    if (option->kind == RN_OPTION_RANGE && parse_integer(option, text, '\0', &pair.first, &rest))
        pair.second = pair.first;
    else if (!parse_integer(option, text, separator, &pair.first, &rest) ||
             !parse_integer(option, rest, '\0', &pair.second, &rest))
        return false;
    if (option->kind == RN_OPTION_RANGE && pair.first > pair.second) return false;
    *ret_pair = pair;
    return true;
}

size_t rn_choices_join(const char *const *names, char ret_text[RN_CHOICES_MAX]) {
    size_t length = 0;
    ret_text[0] = '\0';
    for (int i = 0; names && names[i] && length < RN_CHOICES_MAX; i++)
        length += (size_t)snprintf(ret_text + length, RN_CHOICES_MAX - length, "%s%s", i ? "|" : "",
                                   names[i]);
    return length;
}

const char *rn_option_choices(const struct rn_option *option, char room[RN_CHOICES_MAX]) {
    if (option->list)
        option->list(room, RN_CHOICES_MAX);
    else if (!rn_choices_join(option->choices, room))
        return NULL;
    return room;
}

static bool is_choice(const char *choices, const char *text) {
    size_t size = strlen(text);
    for (const char *choice = choices; size; choice++) {
        size_t choice_size = strcspn(choice, "|");
        if (choice_size == size && memcmp(choice, text, size) == 0) return true;
        choice += choice_size;
        if (!*choice) return false;
    }
    return false;
}

static bool set_value(const struct rn_option *option, const char *value, void *field) {
    const char *rest = NULL;
    char room[RN_CHOICES_MAX];
    switch (option->kind) {
    case RN_OPTION_FLAG:
        *(bool *)field = true;
        return true;
    case RN_OPTION_CHOICE:
        if (!is_choice(rn_option_choices(option, room), value)) return false;
        *(const char **)field = value;
        return true;
    case RN_OPTION_TEXT:
        *(const char **)field = value;
        return *value != '\0';
    case RN_OPTION_INTEGER:
        return parse_integer(option, value, '\0', field, &rest);
    case RN_OPTION_NUMBER:
    case RN_OPTION_SECONDS:
    case RN_OPTION_BYTES:
        return parse_number(option, value, field);
    case RN_OPTION_SIZE:
    case RN_OPTION_RANGE:
        return parse_pair(option, value, field);
    case RN_OPTION_SETTINGS:
        break; // take_setting
    }
    return false;
}

// What the option's value has to be, as a sentence goes on after "must be".
static void tell_wanted(const struct rn_option *option, char text[200]) {
    const char *const kind[] = {[RN_OPTION_INTEGER] = "a whole number",
                                [RN_OPTION_NUMBER] = "a number",
                                [RN_OPTION_SIZE] = "two whole numbers, such as 800x600, each",
                                [RN_OPTION_RANGE] = "A or A-B, whole numbers with A not over B,"};
    char room[RN_CHOICES_MAX];
    const char *choices = rn_option_choices(option, room);
    if (choices)
        snprintf(text, 200, "one of %s", choices);
    else if (option->kind == RN_OPTION_SECONDS)
        snprintf(text, 200, "a time such as 90, 60s, 10m or 1.5h, from %.16g s to %.16g h",
                 option->min, option->max / 3600);
    else if (option->kind == RN_OPTION_BYTES)
        snprintf(text, 200, "a size such as 4096, 40M or 2G, from %.16g to %.16g bytes",
                 option->min, option->max);
    else
        snprintf(text, 200, "%s from %.16g to %.16g", kind[option->kind], option->min, option->max);
}

static enum rn_status complain(const struct rn_option *option, const char *value,
                               struct rn_error *err) {
    char where[64], wanted[200];
    snprintf(where, sizeof where, "--%s", option->name);
    if (option->kind == RN_OPTION_TEXT)
        return rn_error_set(err, RN_ERROR_INVALID, where, "must not be empty");
    tell_wanted(option, wanted);
    return rn_error_set(err, RN_ERROR_INVALID, where, "must be %s; it is '%s'", wanted, value);
}

// The option that an argument names; *ret_value is what follows its '='.
static const struct rn_option *find(const struct rn_option *table, const char *argument,
                                    const char **ret_value) {
    size_t size = strcspn(argument, "=");
    for (const struct rn_option *option = table; option->name; option++) {
        bool is_long = size > 2 && strlen(option->name) == size - 2 && argument[1] == '-' &&
                       memcmp(option->name, argument + 2, size - 2) == 0;
        bool is_short = option->letter && argument[1] == option->letter && !argument[2];
        if (is_long || is_short) {
            *ret_value = is_long && argument[size] ? argument + size + 1 : NULL;
            return option;
        }
    }
    return NULL;
}

// The row of settings that an argument names, of a table's SETTINGS; *ret_option is these.
static const struct rn_setting *find_setting(const struct rn_option *table, const char *argument,
                                             const struct rn_option **ret_option,
                                             const char **ret_value) {
    size_t size = strcspn(argument, "=");
    for (const struct rn_option *option = table; option->name; option++)
        if (option->settings && size > 2 && argument[1] == '-') {
            const struct rn_setting *row =
                rn_settings_flagged(option->settings, 0, argument + 2, size - 2);
            if (!row) continue;
            *ret_value = argument[size] ? argument + size + 1 : NULL;
            *ret_option = option;
            return row;
        }
    return NULL;
}

// " KEY, KEY" of the rows that share the flag of `first`.
static void list_keys(const struct rn_settings *settings, const struct rn_setting *first,
                      char ret_text[KEYS_MAX]) {
    const struct rn_setting *row;
    size_t from = 0, length = 0, flag = strlen(first->flag);
    while ((row = rn_settings_flagged(settings, from, first->flag, flag)) && length < KEYS_MAX) {
        from = (size_t)(row - settings->rows) + 1;
        length += (size_t)snprintf(ret_text + length, KEYS_MAX - length, "%s %s",
                                   row == first ? "" : ",", row->key);
    }
}

// Of rows that share the flag of `first`, the one that "KEY=VALUE" names; *value becomes VALUE.
static enum rn_status find_key(const struct rn_settings *settings, const struct rn_setting *first,
                               const char **value, const struct rn_setting **ret_row,
                               struct rn_error *err) {
    size_t size = strcspn(*value, "="), flag = strlen(first->flag), from = 0;
    struct rn_nearest nearest = {.word = *value, .size = size};
    const struct rn_setting *row;
    while ((row = rn_settings_flagged(settings, from, first->flag, flag))) {
        from = (size_t)(row - settings->rows) + 1;
        rn_nearest_try(&nearest, row->key);
        if (strlen(row->key) != size || memcmp(row->key, *value, size) != 0) continue;
        *value += size + ((*value)[size] == '=');
        *ret_row = row;
        return RN_OK;
    }
    if (nearest.name)
        return rn_error_set(err, RN_ERROR_INVALID, first->flag,
                            "there is no '%.*s'; did you mean %s?", (int)size, *value,
                            nearest.name);
    char keys[KEYS_MAX];
    list_keys(settings, first, keys);
    return rn_error_set(err, RN_ERROR_INVALID, first->flag, "there is no '%.*s'; there is%s",
                        (int)size, *value, keys);
}

// Takes a setting and its value, if that is one: *ret_taken.
static enum rn_status take_setting(const struct rn_option_tables *tables, int argc, char **argv,
                                   int *i, bool *ret_taken, struct rn_error *err) {
    const struct rn_option *option = NULL;
    const char *value = NULL, *argument = argv[*i];
    const struct rn_setting *row = find_setting(tables->table, argument, &option, &value);
    *ret_taken = row != NULL;
    if (!row) return RN_OK;
    ++*i;
    if (!value && rn_setting_is_flag(row)) value = "true";
    if (!value && *i >= argc)
        return rn_error_set(err, RN_ERROR_INVALID, argument, "needs a value: %s", row->meaning);
    if (!value) value = argv[(*i)++];
    union rn_setting_value *values = field_of(option, tables->options);
    enum rn_status status = RN_OK;
    if (row->key) status = find_key(option->settings, row, &value, &row, err);
    if (status == RN_OK)
        status = rn_setting_parse(row, value, &values[row - option->settings->rows], err);
    if (status != RN_OK && err) snprintf(err->where, sizeof err->where, "--%s", row->flag);
    return status;
}

static void try_names(const struct rn_option *table, struct rn_nearest *nearest) {
    for (const struct rn_option *option = table; option->name; option++) {
        if (*option->name) rn_nearest_try(nearest, option->name);
        for (size_t i = 0; option->settings && i < option->settings->count; i++)
            if (option->settings->rows[i].flag)
                rn_nearest_try(nearest, option->settings->rows[i].flag);
    }
}

static enum rn_status complain_of_none(const struct rn_option_tables *tables, const char *argument,
                                       struct rn_error *err) {
    const char *word = argument + strspn(argument, "-");
    struct rn_nearest nearest = {.word = word, .size = strcspn(word, "=")};
    try_names(tables->table, &nearest);
    try_names(tables->global_table, &nearest);
    return rn_error_set(err, RN_ERROR_INVALID, argument, "there is no such option%s%s%s",
                        nearest.name ? "; did you mean --" : "", nearest.name ? nearest.name : "",
                        nearest.name ? "?" : "");
}

// Takes one option and its value; *i moves behind them.
static enum rn_status take_option(const struct rn_option_tables *tables, int argc, char **argv,
                                  int *i, struct rn_error *err) {
    const char *argument = argv[(*i)++], *value = NULL;
    void *options = tables->options;
    const struct rn_option *option = find(tables->table, argument, &value);
    if (!option) {
        option = find(tables->global_table, argument, &value);
        options = tables->globals;
    }
    if (!option) return complain_of_none(tables, argument, err);
    if (option->kind == RN_OPTION_FLAG && value)
        return rn_error_set(err, RN_ERROR_INVALID, argument, "takes no value");
    if (option->kind != RN_OPTION_FLAG && !value) {
        if (*i >= argc)
            return rn_error_set(err, RN_ERROR_INVALID, argument, "needs a value: %s",
                                option->value);
        value = argv[(*i)++];
    }
    if (!set_value(option, value, field_of(option, options))) return complain(option, value, err);
    return RN_OK;
}

enum rn_status rn_options_parse(const struct rn_option_tables *tables, int argc, char **argv,
                                size_t arg_max, const char **ret_args, size_t *ret_arg_count,
                                struct rn_error *err) {
    size_t count = 0;
    bool options_end = false;
    for (int i = 0; i < argc;) {
        if (!options_end && strcmp(argv[i], "--") == 0) {
            options_end = true;
            i++;
        } else if (!options_end && argv[i][0] == '-' && argv[i][1]) {
            bool taken = false;
            enum rn_status status = take_setting(tables, argc, argv, &i, &taken, err);
            if (status == RN_OK && !taken) status = take_option(tables, argc, argv, &i, err);
            if (status != RN_OK) return status;
        } else if (count == arg_max) {
            return rn_error_set(err, RN_ERROR_INVALID, argv[i], "is one argument too many");
        } else if (!*argv[i]) {
            return rn_error_set(err, RN_ERROR_INVALID, "", "an argument is empty");
        } else {
            ret_args[count++] = argv[i++];
        }
    }
    ret_args[count] = NULL;
    *ret_arg_count = count;
    return check_needs(tables->table, tables->options, err);
}

static bool is_member(const struct rn_option *option, const char *member) {
    if (option->members) return is_choice(option->members, member);
    size_t i = 0;
    while (member[i] && option->name[i] == (member[i] == '_' ? '-' : member[i]))
        i++;
    return i && !member[i] && !option->name[i];
}

bool rn_options_find_member(const struct rn_option *table, const char *pointer, char *ret_option,
                            size_t capacity) {
    const char *slash = strrchr(pointer, '/'), *flag = NULL;
    for (const struct rn_option *option = table; slash && option->name && !flag; option++) {
        if (is_member(option, slash + 1)) flag = option->name;
        for (size_t i = 0; option->settings && i < option->settings->count && !flag; i++) {
            const struct rn_setting *row = &option->settings->rows[i];
            if (row->option && strcmp(row->option, slash + 1) == 0) flag = row->flag;
        }
    }
    if (flag) snprintf(ret_option, capacity, "--%s", flag);
    return flag;
}

// ---- help -------------------------------------------------------------------------------------

enum { LEFT = 24, COLUMN = LEFT + 4, WIDTH = 80 };

void rn_options_print_text(const char *text, int column, int indent) {
    while (*text) {
        size_t word = strcspn(text, " \n");
        if (column > indent && column + 1 + (int)word > WIDTH) {
            printf("\n%*s", indent, "");
            column = indent;
        } else if (column > indent) {
            putchar(' ');
            column++;
        }
        printf("%.*s", (int)word, text);
        column += (int)word;
        text += word;
        if (text[0] == '\n' && (text[1] == '\n' || text[1] == ' ')) { // a paragraph, or set by hand
            size_t blank = strspn(text, "\n");
            printf("%s", blank > 1 ? "\n\n" : "\n");
            text += blank;
            column = indent;
            size_t spaces = strspn(text, " ");
            printf("%.*s", (int)spaces, text);
            column += (int)spaces;
            text += spaces;
            if (spaces) { // such a line stays as it is
                size_t rest = strcspn(text, "\n");
                printf("%.*s\n", (int)rest, text);
                text += rest;
                column = indent;
            }
        }
        text += strspn(text, " \n");
    }
    putchar('\n');
}

static void print_line(const char *left, const char *help) {
    printf(strlen(left) <= LEFT ? "  %-*s  " : "  %-*s\n%*s", LEFT, left, COLUMN, "");
    rn_options_print_text(help, COLUMN, COLUMN);
}

// An option of many choices lists them behind its meaning.
static void print_choices(const char *name, const char *choices, const char *help) {
    char left[80], text[600];
    snprintf(left, sizeof left, "--%s WORD", name);
    size_t length = (size_t)snprintf(text, sizeof text, "%s: ", help);
    for (; *choices && length + 3 < sizeof text; choices++)
        length += (size_t)snprintf(text + length, sizeof text - length, "%s",
                                   *choices == '|' ? ", " : (char[]){*choices, '\0'});
    print_line(left, text);
}

// Rows that share a flag, told as one.
static void print_keys(const struct rn_settings *settings, const struct rn_setting *first) {
    char left[RN_CHOICES_MAX + 80], text[600], room[RN_CHOICES_MAX], keys[KEYS_MAX];
    rn_choices_join(first->choices, room);
    snprintf(left, sizeof left, "--%s NAME=%s", first->flag, room);
    list_keys(settings, first, keys);
    snprintf(text, sizeof text, "%s:%s", first->meaning, keys);
    print_line(left, text);
}

static void print_setting(const struct rn_settings *settings, const struct rn_setting *row) {
    if (row->key) {
        if (rn_settings_flagged(settings, 0, row->flag, strlen(row->flag)) == row)
            print_keys(settings, row);
        return;
    }
    char left[RN_CHOICES_MAX + 80], room[RN_CHOICES_MAX];
    const char *value = rn_choices_join(row->choices, room) ? room
                        : rn_setting_is_flag(row)           ? ""
                        : strcmp(row->unit, "s") == 0       ? "T"
                        : strcmp(row->unit, "dB") == 0      ? "DB"
                        : row->type == RN_SETTING_NUMBER    ? "X"
                                                            : "N";
    int length = snprintf(left, sizeof left, "--%s %s", row->flag, value);
    if (row->choices && length > WIDTH - 8)
        print_choices(row->flag, room, row->meaning);
    else
        print_line(left, row->meaning);
}

void rn_options_print(const struct rn_option *table) {
    for (const struct rn_option *option = table; option->name; option++) {
        for (size_t i = 0; option->settings && i < option->settings->count; i++)
            if (option->settings->rows[i].flag)
                print_setting(option->settings, &option->settings->rows[i]);
        if (option->settings) continue;
        char left[80];
        char room[RN_CHOICES_MAX];
        const char *choices = rn_option_choices(option, room);
        const char *value = choices ? choices : option->value;
        char letter[5] = {'-', option->letter, ',', ' ', '\0'};
        int length = snprintf(left, sizeof left, "%s--%s%s%s", option->letter ? letter : "",
                              option->name, value ? " " : "", value ? value : "");
        if (choices && length > WIDTH - 8)
            print_choices(option->name, choices, option->help);
        else
            print_line(left, option->help);
    }
}
