#include "client/nearest.h"

#include <stdbool.h>
#include <string.h>

enum { MOST = 32, SLIPS = 2 };

static size_t least(size_t a, size_t b) {
    return a < b ? a : b;
}

// The optimal string alignment distance of two words below MOST bytes.
static size_t distance(const char *a, size_t a_size, const char *b, size_t b_size) {
    size_t rows[MOST][MOST];
    for (size_t i = 0; i <= a_size; i++)
        for (size_t j = 0; j <= b_size; j++) {
            if (!i || !j) {
                rows[i][j] = i + j;
                continue;
            }
            size_t slips = rows[i - 1][j - 1] + (a[i - 1] != b[j - 1]);
            slips = least(slips, 1 + least(rows[i - 1][j], rows[i][j - 1]));
            bool exchanged = i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1];
            rows[i][j] = exchanged ? least(slips, 1 + rows[i - 2][j - 2]) : slips;
        }
    return rows[a_size][b_size];
}

void rn_nearest_try(struct rn_nearest *nearest, const char *name) {
    size_t size = strlen(name);
    if (nearest->size >= MOST || size >= MOST) return;
    size_t slips = distance(nearest->word, nearest->size, name, size);
    if (slips > SLIPS || 2 * slips >= nearest->size) return;
    if (nearest->name && slips >= nearest->distance) return;
    nearest->name = name;
    nearest->distance = slips;
}
