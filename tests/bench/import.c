// Imports a dataset folder without a daemon: import SOURCE TARGET MAX_SIZE SCALES [EVERY [FORMAT]];
// each EVERY-th view tests.
#include <stdio.h>
#include <stdlib.h>

#include "common/base/file.h"
#include "common/dataset/dataset.h"

int main(int argc, char **argv) {
    struct rn_error err = {0};
    struct rn_dataset *dataset = NULL;
    if (argc < 5 || argc > 7) {
        fprintf(stderr, "usage: import SOURCE TARGET MAX_SIZE SCALES [EVERY [FORMAT]]\n");
        return 2;
    }
    struct rn_import_options options = {.max_size = atoi(argv[3]),
                                        .scales = atoi(argv[4]),
                                        .test_every = argc > 5 ? atoi(argv[5]) : 0,
                                        .threads = 2};
    struct rn_read_options how = {.format = argc > 6 ? argv[6] : NULL};
    if (rn_dataset_read_as(argv[1], &how, NULL, &dataset, &err) != RN_OK ||
        rn_mkdirs(argv[2], 0755, &err) != RN_OK ||
        rn_dataset_import(dataset, "bench", &options, argv[2], NULL, NULL, NULL, &err) != RN_OK) {
        fprintf(stderr, "import: %s: %s\n", err.where, err.text);
        return 1;
    }
    rn_dataset_destroy(&dataset);
    return 0;
}
