#include "server/runner/ingest/pairs.h"

#include <errno.h>
#include <math.h>
#include <sqlite3.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/dataset/dataset.h"

#define LENGTH 128 // of a descriptor; its square sums to about 512^2
#define NORM2 (512.0f * 512.0f)
#define RATIO2 0.64f // squared distances of the best and the second: 0.8, as COLMAP has it
#define FEWEST_MATCHES 4
#define FEATURES_LEAST 64
#define FEATURES_MOST 192
#define PRODUCTS 2e11 // of numbers in all, about ten seconds
#define REACH 1500    // photographs further on, with which each is compared
#define APART_M 8.0   // of half of the photographs from the next: GPS is off by less as a rule

// The largest features of a photograph, 16 bits a number: the compiler multiplies those in pairs.
struct features {
    int16_t *values; // count * LENGTH
    int count;
};

struct partner {
    int other, matches;
};

struct choice {
    const struct rn_photos *photos;
    struct features *features;
    struct partner (*partners)[RN_PAIRS_PARTNERS]; // most matches first; matches 0: none
    int (*around)[RN_PAIRS_AROUND];                // nearest first, -1: none; NULL: not placed
    int most;                                      // features of a photograph
};

// ---- where they were taken ----

// Along the ground; infinite where GPS does not say.
static double metres_apart(const struct rn_photo *a, const struct rn_photo *b) {
    double metres[3];
    if (!a->info.located || !b->info.located) return INFINITY;
    rn_located_metres(a->info.located_at, b->info.located_at, metres);
    return hypot(metres[0], metres[1]);
}

// The photograph's nearest.
static void look_around(const struct rn_photos *photos, size_t i, int around[RN_PAIRS_AROUND]) {
    double apart[RN_PAIRS_AROUND];
    for (int k = 0; k < RN_PAIRS_AROUND; k++) {
        apart[k] = INFINITY;
        around[k] = -1;
    }
    for (size_t j = 0; j < photos->count; j++) {
        double metres = j == i ? INFINITY : metres_apart(&photos->items[i], &photos->items[j]);
        int at = RN_PAIRS_AROUND;
        while (at > 0 && metres < apart[at - 1])
            at--;
        if (at == RN_PAIRS_AROUND) continue;
        size_t after = (size_t)(RN_PAIRS_AROUND - at - 1);
        memmove(apart + at + 1, apart + at, after * sizeof *apart);
        memmove(around + at + 1, around + at, after * sizeof *around);
        apart[at] = metres;
        around[at] = (int)j;
    }
}

bool rn_pairs_are_placed(const struct rn_photos *photos) {
    size_t placed = 0;
    for (size_t i = 0; i < photos->count; i++) {
        int around[RN_PAIRS_AROUND];
        look_around(photos, i, around);
        placed +=
            around[0] >= 0 && metres_apart(&photos->items[i], &photos->items[around[0]]) >= APART_M;
    }
    return 2 * placed > photos->count;
}

size_t rn_pairs_expected(const struct rn_photos *photos, bool placed) {
    size_t all = photos->count * (photos->count - 1) / 2;
    // Two that are partners are so to each other as a rule, and most of those around are.
    size_t each = RN_PAIRS_PARTNERS * 2 / 3 + (photos->in_order ? RN_PAIRS_NEAR - 1 : 0) +
                  (placed ? RN_PAIRS_AROUND / 4 : 0);
    size_t some = photos->count * each;
    return some < all ? some : all;
}

// ---- names ----

// COLMAP reads a name in a list up to a blank, and a line that begins with # not at all. There they
// are written with "//", which no path below a folder has.
#define IN_PLACE "//"

static bool is_listed_as_it_is(const char *name) {
    return !strpbrk(name, " \t\n") && name[0] != '#';
}

// malloc'd; NULL when memory is out.
static char *listed_name(const char *name) {
    char *listed = malloc(2 * strlen(name) + sizeof IN_PLACE), *to = listed;
    if (!listed) return NULL;
    if (name[0] == '#') to = stpcpy(to, IN_PLACE);
    for (; *name; name++)
        if (strchr(" \t\n", *name))
            to = stpcpy(to, IN_PLACE);
        else
            *to++ = *name;
    *to = '\0';
    return listed;
}

// ---- COLMAP's database ----

static enum rn_status complain(sqlite3 *db, const char *path, struct rn_error *err) {
    return rn_error_set(err, RN_ERROR_CORRUPT, path, "COLMAP's database cannot be used: %s",
                        sqlite3_errmsg(db));
}

static enum rn_status rename_photo(sqlite3 *db, sqlite3_stmt *query, const char *path,
                                   const char *name, bool listed, struct rn_error *err) {
    char *other = listed_name(name);
    if (!other) return rn_error_set(err, RN_ERROR_NO_MEMORY, path, "out of memory");
    sqlite3_bind_text(query, 1, listed ? other : name, -1, SQLITE_STATIC);
    sqlite3_bind_text(query, 2, listed ? name : other, -1, SQLITE_STATIC);
    int code = sqlite3_step(query);
    sqlite3_reset(query);
    free(other);
    return code == SQLITE_DONE ? RN_OK : complain(db, path, err);
}

enum rn_status rn_pairs_rename(const struct rn_photos *photos, const char *database, bool listed,
                               struct rn_error *err) {
    sqlite3 *db = NULL;
    sqlite3_stmt *query = NULL;
    enum rn_status status = RN_OK;
    size_t i = 0;
    while (i < photos->count && is_listed_as_it_is(photos->items[i].name))
        i++;
    if (i == photos->count) return RN_OK;
    if (sqlite3_open_v2(database, &db, SQLITE_OPEN_READWRITE, NULL) != SQLITE_OK ||
        sqlite3_exec(db, "BEGIN", NULL, NULL, NULL) != SQLITE_OK ||
        sqlite3_prepare_v2(db, "UPDATE images SET name = ? WHERE name = ?", -1, &query, NULL) !=
            SQLITE_OK)
        status = complain(db, database, err);
    for (; status == RN_OK && i < photos->count; i++)
        if (!is_listed_as_it_is(photos->items[i].name))
            status = rename_photo(db, query, database, photos->items[i].name, listed, err);
    sqlite3_finalize(query);
    if (status == RN_OK && sqlite3_exec(db, "COMMIT", NULL, NULL, NULL) != SQLITE_OK)
        status = complain(db, database, err);
    sqlite3_close(db);
    return status;
}

// COLMAP keeps features from the finest to the coarsest: the last are the largest.
static enum rn_status take_features(const struct choice *choice, sqlite3_stmt *query,
                                    const char *path, struct features *features,
                                    struct rn_error *err) {
    int rows = sqlite3_column_int(query, 0), size = sqlite3_column_bytes(query, 1);
    const uint8_t *bytes = sqlite3_column_blob(query, 1);
    if (rows < 0 || size % LENGTH || size / LENGTH != rows)
        return rn_error_set(err, RN_ERROR_CORRUPT, path,
                            "COLMAP's database has %d bytes of descriptors for %d features", size,
                            rows);
    features->count = rows < choice->most ? rows : choice->most;
    size_t count = (size_t)features->count * LENGTH, first = (size_t)size - count;
    features->values = malloc((count + 1) * sizeof *features->values);
    if (!features->values) return rn_error_set(err, RN_ERROR_NO_MEMORY, path, "out of memory");
    for (size_t i = 0; i < count; i++)
        features->values[i] = bytes[first + i];
    return RN_OK;
}

static enum rn_status read_features(struct choice *choice, const char *path, struct rn_error *err) {
    static const char text[] = "SELECT rows, data FROM descriptors JOIN images USING (image_id) "
                               "WHERE images.name = ?";
    sqlite3 *db = NULL;
    sqlite3_stmt *query = NULL;
    enum rn_status status = RN_OK;
    if (sqlite3_open_v2(path, &db, SQLITE_OPEN_READONLY, NULL) != SQLITE_OK ||
        sqlite3_prepare_v2(db, text, -1, &query, NULL) != SQLITE_OK)
        status = complain(db, path, err);
    for (size_t i = 0; status == RN_OK && i < choice->photos->count; i++) {
        sqlite3_bind_text(query, 1, choice->photos->items[i].name, -1, SQLITE_STATIC);
        int code = sqlite3_step(query);
        if (code == SQLITE_ROW)
            status = take_features(choice, query, path, &choice->features[i], err);
        else if (code != SQLITE_DONE)
            status = complain(db, path, err);
        sqlite3_reset(query);
    }
    sqlite3_finalize(query);
    sqlite3_close(db);
    return status;
}

// ---- matches ----

static int product(const int16_t *a, const int16_t *b) {
    int sum = 0;
    for (int i = 0; i < LENGTH; i++)
        sum += a[i] * b[i];
    return sum;
}

// The feature of `b` that is most like `a`, if no other is nearly as like; -1 else.
static int most_alike(const int16_t *a, const struct features *b) {
    int best = -1, second = -1, at = -1;
    for (int j = 0; j < b->count; j++) {
        int p = product(a, b->values + (size_t)j * LENGTH);
        if (p > best) {
            second = best;
            best = p;
            at = j;
        } else if (p > second) {
            second = p;
        }
    }
    float first2 = 2 * (NORM2 - (float)best), second2 = 2 * (NORM2 - (float)second);
    return at >= 0 && first2 < RATIO2 * second2 ? at : -1;
}

// Features that are the most alike of each other.
static int count_matches(const struct features *a, const struct features *b) {
    int matches = 0;
    for (int i = 0; i < a->count; i++) {
        const int16_t *own = a->values + (size_t)i * LENGTH;
        int j = most_alike(own, b);
        matches += j >= 0 && most_alike(b->values + (size_t)j * LENGTH, a) == i;
    }
    return matches;
}

static void keep(struct partner partners[RN_PAIRS_PARTNERS], int other, int matches) {
    int at = RN_PAIRS_PARTNERS;
    while (at > 0 && partners[at - 1].matches < matches)
        at--;
    if (at == RN_PAIRS_PARTNERS) return;
    memmove(partners + at + 1, partners + at,
            (size_t)(RN_PAIRS_PARTNERS - at - 1) * sizeof *partners);
    partners[at] = (struct partner){other, matches};
}

static enum rn_status compare_all(struct choice *choice, bool (*keep_going)(void *context),
                                  void *context, struct rn_error *err) {
    int count = (int)choice->photos->count;
    for (int i = 0; i < count; i++) {
        if (!keep_going(context))
            return rn_error_set(err, RN_ERROR_CANCELLED, "import", "was told to end");
        for (int j = i + 1; j < count && j <= i + REACH; j++) {
            int matches = count_matches(&choice->features[i], &choice->features[j]);
            if (matches < FEWEST_MATCHES) continue;
            keep(choice->partners[i], j, matches);
            keep(choice->partners[j], i, matches);
        }
    }
    return RN_OK;
}

// ---- the list ----

static bool has_partner(const struct partner partners[RN_PAIRS_PARTNERS], int other) {
    for (int k = 0; k < RN_PAIRS_PARTNERS; k++)
        if (partners[k].matches && partners[k].other == other) return true;
    return false;
}

static bool is_around(const int around[RN_PAIRS_AROUND], int other) {
    for (int k = 0; k < RN_PAIRS_AROUND; k++)
        if (around[k] == other) return true;
    return false;
}

static bool is_near(const struct choice *choice, int i, int j) {
    if (choice->photos->in_order && abs(i - j) <= RN_PAIRS_NEAR) return true;
    return choice->around && (is_around(choice->around[i], j) || is_around(choice->around[j], i));
}

// Each pair once: those near, then partners that are not.
static size_t write_pairs(const struct choice *choice, char **names, FILE *file) {
    size_t pairs = 0;
    int count = (int)choice->photos->count;
    for (int i = 0; i < count; i++) {
        for (int j = i + 1; j < count; j++) {
            if (!is_near(choice, i, j)) continue;
            fprintf(file, "%s %s\n", names[i], names[j]);
            pairs++;
        }
        for (int k = 0; k < RN_PAIRS_PARTNERS && choice->partners[i][k].matches; k++) {
            int j = choice->partners[i][k].other;
            if (is_near(choice, i, j) || (j < i && has_partner(choice->partners[j], i))) continue;
            fprintf(file, "%s %s\n", names[i], names[j]);
            pairs++;
        }
    }
    return pairs;
}

static enum rn_status write_list(const struct choice *choice, const char *path, size_t *ret_pairs,
                                 struct rn_error *err) {
    size_t count = choice->photos->count, named = 0, pairs = 0;
    char **names = calloc(count, sizeof *names);
    while (names && named < count &&
           (names[named] = listed_name(choice->photos->items[named].name)))
        named++;
    enum rn_status status =
        named == count ? RN_OK : rn_error_set(err, RN_ERROR_NO_MEMORY, path, "out of memory");
    FILE *file = status ? NULL : fopen(path, "we");
    if (file) pairs = write_pairs(choice, names, file);
    if (status == RN_OK && (!file || fclose(file) != 0))
        status = rn_error_from_errno(err, errno, path, "write");
    for (size_t i = 0; names && i < count; i++)
        free(names[i]);
    free(names);
    if (status == RN_OK) *ret_pairs = pairs;
    return status;
}

enum rn_status rn_pairs_choose(const struct rn_photos *photos, bool placed, const char *database,
                               const char *list, bool (*keep_going)(void *context), void *context,
                               size_t *ret_pairs, struct rn_error *err) {
    double all =
        0.5 * (double)photos->count * (double)(photos->count < REACH ? photos->count : REACH);
    double most = sqrt(PRODUCTS / (2 * LENGTH * all));
    struct choice choice = {.photos = photos,
                            .features = calloc(photos->count, sizeof *choice.features),
                            .partners = calloc(photos->count, sizeof *choice.partners),
                            .most = (int)fmin(fmax(most, FEATURES_LEAST), FEATURES_MOST)};
    enum rn_status status = RN_OK;
    if (placed) choice.around = calloc(photos->count, sizeof *choice.around);
    if (!choice.features || !choice.partners || (placed && !choice.around))
        status = rn_error_set(err, RN_ERROR_NO_MEMORY, database, "out of memory");
    for (size_t i = 0; status == RN_OK && placed && i < photos->count; i++)
        look_around(photos, i, choice.around[i]);
    if (status == RN_OK) status = read_features(&choice, database, err);
    if (status == RN_OK) status = compare_all(&choice, keep_going, context, err);
    if (status == RN_OK) status = write_list(&choice, list, ret_pairs, err);
    for (size_t i = 0; choice.features && i < photos->count; i++)
        free(choice.features[i].values);
    free(choice.features);
    free(choice.partners);
    free(choice.around);
    return status;
}
