// Imports a dataset folder without a daemon: import SOURCE TARGET MAX_SIZE SCALES.
#include <stdio.h>
#include <stdlib.h>

#include "common/base/file.h"
#include "common/dataset/dataset.h"

int main(int argc, char **argv) {
    struct rn_error err = {0};
    struct rn_dataset *dataset = NULL;
    if (argc != 5) {
        fprintf(stderr, "usage: import SOURCE TARGET MAX_SIZE SCALES\n");
        return 2;
    }
    struct rn_import_options options = {
        .max_size = atoi(argv[3]), .scales = atoi(argv[4]), .threads = 2};
    if (rn_dataset_read(argv[1], NULL, &dataset, &err) != RN_OK ||
        rn_mkdirs(argv[2], 0755, &err) != RN_OK ||
        rn_dataset_import(dataset, "bench", &options, argv[2], NULL, NULL, NULL, &err) != RN_OK) {
        fprintf(stderr, "import: %s: %s\n", err.where, err.text);
        return 1;
    }
    rn_dataset_destroy(&dataset);
    return 0;
}
