#include "proto/checks.h"

#include <stdbool.h>
#include <stddef.h>
#include <string.h>

#include "proto/dataset.h"
#include "proto/job.h"
#include "proto/names.h"

#define LOWER "abcdefghijklmnopqrstuvwxyz"
#define UPPER "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
#define DIGITS "0123456789"

static bool made_of(const char *text, const char *set) {
    return text[strspn(text, set)] == '\0';
}

const char *rn_check_reference(const char *text) {
    if (*text && strlen(text) < RN_NAME_MAX && made_of(text, LOWER UPPER DIGITS "._-") &&
        !strchr("._-", *text))
        return NULL;
    return "must be 1 to 64 letters, digits, '.', '_' and '-', the first a letter or digit";
}

const char *rn_check_name(const char *text) {
    static const char *const prefixes[] = {RN_ID_DATASET, RN_ID_SCENE, RN_ID_JOB, RN_ID_PATH,
                                           RN_ID_TOKEN};
    for (size_t i = 0; i < sizeof prefixes / sizeof *prefixes; i++)
        if (strncmp(text, prefixes[i], strlen(prefixes[i])) == 0)
            return "must not begin like an id (ds_, sc_, job_, path_, tok_)";
    return rn_check_reference(text);
}

const char *rn_check_split_spec(const char *text) {
    static const char prefix[] = "every:";
    const char *number = text + strlen(prefix);
    if (strcmp(text, "files") == 0) return NULL;
    if (strncmp(text, prefix, strlen(prefix)) == 0 && *number >= '1' && *number <= '9' &&
        made_of(number, DIGITS) && strlen(number) <= 6)
        return NULL;
    return "must be \"files\" or \"every:N\" with N from 1 to 999999";
}

const char *rn_check_bounds(const char *text) {
    double centre[3], radius;
    if (made_of(text, DIGITS "+-.eE,") && rn_ingest_bounds(text, centre, &radius)) return NULL;
    return "must be X,Y,Z,RADIUS: four numbers, the radius above 0";
}

const char *rn_check_up(const char *text) {
    double up[3];
    if (made_of(text, DIGITS "+-.eE,xyz") && rn_ingest_up(text, up)) return NULL;
    return "must be X,Y,Z, a direction, or an axis such as z or -y";
}

const char *rn_check_crop(const char *text) {
    struct rn_box crop;
    if (made_of(text, DIGITS "+-.eE,") && rn_ingest_crop(text, &crop)) return NULL;
    return "must be X0,Y0,Z0,X1,Y1,Z1: a box's low corner, then its high one";
}

const char *rn_check_inner_path(const char *text) {
    bool leaves = *text == '/';
    for (const char *part = text; part; part = strchr(part, '/')) {
        part += *part == '/';
        leaves = leaves || (strncmp(part, "..", 2) == 0 && (part[2] == '/' || !part[2]));
    }
    return *text && !leaves ? NULL : "must be a path within the dataset's folder";
}

const char *rn_check_format(const char *text) {
    static _Thread_local char wrong[256] = "must be one of ";
    static const size_t begun = sizeof "must be one of " - 1;
    if (rn_format_find(text)) return NULL;
    rn_format_names(wrong + begun, sizeof wrong - begun);
    return wrong;
}

const char *rn_check_device(const char *text) {
    static const char prefix[] = "cuda:";
    const char *number = text + strlen(prefix);
    if (strcmp(text, "auto") == 0 || strcmp(text, "cpu") == 0) return NULL;
    if (strncmp(text, prefix, strlen(prefix)) == 0 && *number && made_of(number, DIGITS) &&
        strlen(number) <= 2)
        return NULL;
    return "must be auto, cpu or cuda:N";
}

const char *rn_check_kernels(const char *text) {
    return *text && made_of(text, LOWER DIGITS "-") ? NULL
                                                    : "must be the name of a kernel set, or auto";
}

const char *rn_check_view(const char *text) {
    for (size_t i = 0; rn_split_names[i]; i++) {
        size_t length = strlen(rn_split_names[i]);
        if (strncmp(text, rn_split_names[i], length) == 0 && text[length] == ':' &&
            text[length + 1])
            return NULL;
    }
    return "must be SPLIT:INDEX or SPLIT:NAME, as test:12 or test:r_12; SPLIT is train, val or "
           "test";
}

const char *rn_check_sha256(const char *text) {
    return strlen(text) == 64 && made_of(text, "abcdef" DIGITS) ? NULL
                                                                : "must be 64 hexadecimal digits";
}
