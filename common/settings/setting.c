#include "common/settings/setting.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/base/names.h"

union rn_setting_value rn_setting_absent(const struct rn_setting *row) {
    union rn_setting_value value = {.text = ""};
    switch (row->type) {
    case RN_SETTING_INT:
    case RN_SETTING_INT64:
    case RN_SETTING_UINT64:
        value.whole = INT64_MIN;
        break;
    case RN_SETTING_NUMBER:
    case RN_SETTING_COLOUR:
        for (int i = 0; i < 3; i++)
            value.colour[i] = NAN;
        break;
    case RN_SETTING_BOOL:
    case RN_SETTING_CHOICE:
        value.choice = -1;
        break;
    case RN_SETTING_TEXT:
        break;
    }
    return value;
}

bool rn_setting_is_absent(const struct rn_setting *row, const union rn_setting_value *value) {
    switch (row->type) {
    case RN_SETTING_INT:
    case RN_SETTING_INT64:
    case RN_SETTING_UINT64:
        return value->whole == INT64_MIN;
    case RN_SETTING_NUMBER:
    case RN_SETTING_COLOUR:
        return isnan(value->number);
    case RN_SETTING_BOOL:
    case RN_SETTING_CHOICE:
        return value->choice < 0;
    case RN_SETTING_TEXT:
        return !*value->text;
    }
    return true;
}

const struct rn_setting *rn_settings_find(const struct rn_settings *settings, const char *name) {
    for (size_t i = 0; i < settings->count; i++)
        if (strcmp(settings->rows[i].name, name) == 0) return &settings->rows[i];
    return NULL;
}

const struct rn_setting *rn_settings_flagged(const struct rn_settings *settings, size_t from,
                                             const char *flag, size_t size) {
    for (size_t i = from; i < settings->count; i++) {
        const char *own = settings->rows[i].flag;
        if (own && strlen(own) == size && memcmp(own, flag, size) == 0) return &settings->rows[i];
    }
    return NULL;
}

union rn_setting_value *rn_settings_value(const struct rn_settings *settings,
                                          union rn_setting_value *values, const char *name) {
    return values + (rn_settings_find(settings, name) - settings->rows);
}

// ---- members --------------------------------------------------------------------------------

static union rn_setting_value value_in(const struct rn_setting *row, const void *config) {
    const char *at = (const char *)config + row->offset;
    union rn_setting_value value = {.text = ""};
    switch (row->type) {
    case RN_SETTING_BOOL:
        value.choice = *(const bool *)at;
        break;
    case RN_SETTING_CHOICE:
        value.choice = *(const int *)at;
        break;
    case RN_SETTING_INT:
        value.whole = *(const int *)at;
        break;
    case RN_SETTING_INT64:
    case RN_SETTING_UINT64:
        value.whole = *(const int64_t *)at;
        break;
    case RN_SETTING_NUMBER:
        value.number = *(const double *)at;
        break;
    case RN_SETTING_COLOUR:
        for (int i = 0; i < 3; i++)
            value.colour[i] = (double)((const float *)at)[i];
        break;
    case RN_SETTING_TEXT:
        memcpy(value.text, at, sizeof value.text);
        break;
    }
    return value;
}

void rn_setting_put(const struct rn_setting *row, const union rn_setting_value *value,
                    void *config) {
    char *at = (char *)config + row->offset;
    if (rn_setting_is_absent(row, value)) return;
    switch (row->type) {
    case RN_SETTING_BOOL:
        *(bool *)at = value->choice != 0;
        break;
    case RN_SETTING_CHOICE:
        *(int *)at = value->choice;
        break;
    case RN_SETTING_INT:
        *(int *)at = (int)value->whole;
        break;
    case RN_SETTING_INT64:
    case RN_SETTING_UINT64:
        *(int64_t *)at = value->whole;
        break;
    case RN_SETTING_NUMBER:
        *(double *)at = value->number;
        break;
    case RN_SETTING_COLOUR:
        for (int i = 0; i < 3; i++)
            ((float *)at)[i] = (float)value->colour[i];
        break;
    case RN_SETTING_TEXT:
        memcpy(at, value->text, sizeof value->text);
        break;
    }
}

void rn_settings_get(const struct rn_settings *settings, const void *config,
                     union rn_setting_value *ret_values) {
    for (size_t i = 0; i < settings->count; i++)
        ret_values[i] = value_in(&settings->rows[i], config);
}

void rn_settings_put(const struct rn_settings *settings, const union rn_setting_value *values,
                     void *config) {
    for (size_t i = 0; i < settings->count; i++)
        rn_setting_put(&settings->rows[i], &values[i], config);
}

union rn_setting_value rn_setting_of_number(const struct rn_setting *row, double number) {
    union rn_setting_value value = {.text = ""};
    switch (row->type) {
    case RN_SETTING_BOOL:
    case RN_SETTING_CHOICE:
        value.choice = (int)number;
        break;
    case RN_SETTING_INT:
    case RN_SETTING_INT64:
    case RN_SETTING_UINT64:
        value.whole = (int64_t)number;
        break;
    case RN_SETTING_NUMBER:
    case RN_SETTING_COLOUR:
        for (int i = 0; i < 3; i++)
            value.colour[i] = number;
        break;
    case RN_SETTING_TEXT:
        break;
    }
    return value;
}

void rn_setting_put_number(const struct rn_setting *row, double number, void *config) {
    union rn_setting_value value = rn_setting_of_number(row, number);
    rn_setting_put(row, &value, config);
}

static double number_of(const struct rn_setting *row, const union rn_setting_value *value) {
    switch (row->type) {
    case RN_SETTING_BOOL:
    case RN_SETTING_CHOICE:
        return value->choice;
    case RN_SETTING_INT:
    case RN_SETTING_INT64:
    case RN_SETTING_UINT64:
        return (double)value->whole;
    case RN_SETTING_NUMBER:
    case RN_SETTING_COLOUR:
        return value->number;
    case RN_SETTING_TEXT:
        break;
    }
    return 0;
}

double rn_setting_number(const struct rn_setting *row, const void *config) {
    union rn_setting_value value = value_in(row, config);
    return number_of(row, &value);
}

// ---- what is allowed ------------------------------------------------------------------------

// "3, 4 or 6": the powers of two of a range, or names.
static void list_values(const struct rn_setting *row, char *ret_text, size_t size) {
    char items[16][24];
    int n = 0;
    for (; row->choices && row->choices[n] && n < 16; n++)
        snprintf(items[n], sizeof items[n], "%s", row->choices[n]);
    for (double v = row->min; !row->choices && v <= row->max && n < 16; v *= 2)
        snprintf(items[n++], sizeof items[0], "%.15g", v);
    size_t length = (size_t)snprintf(ret_text, size, "must be %s", items[0]);
    for (int i = 1; i < n && length < size; i++)
        length += (size_t)snprintf(ret_text + length, size - length, "%s%s",
                                   i + 1 < n ? ", " : " or ", items[i]);
}

// "must be 2 to 4096 texels", "must be rip, mip or point": what is allowed.
static void tell_range(const struct rn_setting *row, char *ret_text, size_t size) {
    const char *unit = row->unit, *space = *unit ? " " : "";
    bool over = row->flags & RN_SETTING_OVER_MIN, under = row->flags & RN_SETTING_UNDER_MAX;
    if (row->choices || row->flags & RN_SETTING_POWER_OF_TWO)
        list_values(row, ret_text, size);
    else if (row->type == RN_SETTING_BOOL)
        snprintf(ret_text, size, "must be true or false");
    else if (row->type == RN_SETTING_TEXT)
        snprintf(ret_text, size, "must have 1 to %d bytes", RN_SETTING_TEXT_MAX - 1);
    else if (row->flags & RN_SETTING_SIXTEENS)
        snprintf(ret_text, size, "must be a multiple of 16, %.15g to %.15g", row->min, row->max);
    else if (over || under)
        snprintf(ret_text, size, "must be %s %.15g and %s %.15g%s%s",
                 over ? "more than" : "at least", row->min, under ? "less than" : "at most",
                 row->max, space, unit);
    else
        snprintf(ret_text, size, "must be %.15g to %.15g%s%s", row->min, row->max, space, unit);
}

static bool is_power_of_two(double number) {
    int exponent;
    return frexp(number, &exponent) == 0.5;
}

static bool in_range(const struct rn_setting *row, double number) {
    bool low = row->flags & RN_SETTING_OVER_MIN ? number > row->min : number >= row->min;
    bool high = row->flags & RN_SETTING_UNDER_MAX ? number < row->max : number <= row->max;
    if (row->flags & RN_SETTING_POWER_OF_TWO && !is_power_of_two(number)) return false;
    if (row->flags & RN_SETTING_SIXTEENS && fmod(number, 16) != 0) return false;
    return low && high;
}

static bool is_choice(const struct rn_setting *row, double number) {
    int n = 0;
    while (row->choices && row->choices[n])
        n++;
    return number >= 0 && number < (row->choices ? n : 2);
}

static bool allows(const struct rn_setting *row, double number) {
    switch (row->type) {
    case RN_SETTING_BOOL:
    case RN_SETTING_CHOICE:
        return is_choice(row, number);
    case RN_SETTING_TEXT:
        return true;
    default:
        return in_range(row, number) || (row->flags & RN_SETTING_OR_ZERO && number == 0);
    }
}

enum rn_status rn_settings_check(const struct rn_settings *settings, const void *config,
                                 struct rn_error *err) {
    for (size_t i = 0; i < settings->count; i++) {
        const struct rn_setting *row = &settings->rows[i];
        union rn_setting_value value = value_in(row, config);
        bool fine = allows(row, number_of(row, &value));
        for (int c = 1; row->type == RN_SETTING_COLOUR && c < 3; c++)
            fine = fine && in_range(row, value.colour[c]);
        if (fine) continue;
        char text[160];
        tell_range(row, text, sizeof text);
        return rn_error_set(err, RN_ERROR_INVALID, row->name, "%s%s", text,
                            row->flags & RN_SETTING_OR_ZERO ? ", or 0" : "");
    }
    return RN_OK;
}

// ---- as people write them -------------------------------------------------------------------

static bool parse_whole(const char *text, int64_t *ret_whole) {
    char *rest = NULL;
    if (*text < '0' || *text > '9') return false;
    errno = 0;
    *ret_whole = strtoll(text, &rest, 10);
    return !errno && !*rest;
}

static bool parse_number(const struct rn_setting *row, const char *text, double *ret_number) {
    char *rest = NULL;
    *ret_number = strtod(text, &rest);
    if (rest == text) return false;
    if (strcmp(row->unit, "s") == 0 && *rest && strchr("smh", *rest))
        *ret_number *= *rest == 'h' ? 3600 : *rest == 'm' ? 60 : 1, rest++;
    if (strcmp(row->unit, "ms") == 0) { // 50 of what? The unit is to be said
        *ret_number *= strcmp(rest, "s") == 0 ? 1000 : 1;
        return strcmp(rest, "ms") == 0 || strcmp(rest, "s") == 0;
    }
    return !*rest;
}

static const char *const truths[] = {"false", "true", NULL};

static bool parse(const struct rn_setting *row, const char *text, union rn_setting_value *value) {
    switch (row->type) {
    case RN_SETTING_BOOL:
    case RN_SETTING_CHOICE:
        value->choice = rn_name_index(row->choices ? row->choices : truths, text);
        return value->choice >= 0;
    case RN_SETTING_INT:
    case RN_SETTING_INT64:
    case RN_SETTING_UINT64:
        return parse_whole(text, &value->whole) && in_range(row, (double)value->whole);
    case RN_SETTING_NUMBER:
        return parse_number(row, text, &value->number) && in_range(row, value->number);
    case RN_SETTING_COLOUR: {
        double *c = value->colour;
        char end;
        return sscanf(text, "%lf,%lf,%lf%c", &c[0], &c[1], &c[2], &end) == 3 &&
               in_range(row, c[0]) && in_range(row, c[1]) && in_range(row, c[2]);
    }
    case RN_SETTING_TEXT:
        snprintf(value->text, sizeof value->text, "%s", text);
        return *text && strlen(text) < sizeof value->text;
    }
    return false;
}

enum rn_status rn_setting_parse(const struct rn_setting *row, const char *text,
                                union rn_setting_value *ret_value, struct rn_error *err) {
    union rn_setting_value value = {.text = ""};
    if (parse(row, text, &value)) {
        *ret_value = value;
        return RN_OK;
    }
    char range[160];
    tell_range(row, range, sizeof range);
    if (strcmp(row->unit, "s") == 0)
        return rn_error_set(err, RN_ERROR_INVALID, row->name,
                            "must be a time such as 90, 60s, 10m or 1.5h, %s; it is '%s'",
                            range + strlen("must be "), text);
    return rn_error_set(err, RN_ERROR_INVALID, row->name, "%s%s; it is '%s'", range,
                        strcmp(row->unit, "ms") == 0 ? ", with its unit: 50ms, 0.5s" : "", text);
}
