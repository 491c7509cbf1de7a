// Columns of text on stdout.
#ifndef RN_CLIENT_TABLE_H
#define RN_CLIENT_TABLE_H

#include <stddef.h>

#include "common/base/status.h"

#define RN_TEXT_TABLE_MAX_COLUMNS 10
#define RN_TEXT_TABLE_CELL 96 // bytes of a cell with its NUL; longer text is cut

// Thread-safety: one thread at a time. Owner: the caller; rn_text_table_finish.
struct rn_text_table {
    size_t columns, rows, capacity;
    char (*cells)[RN_TEXT_TABLE_CELL]; // row by row, the heading first
    bool failed;                       // memory ran out
};

// `heading` is the columns' names, separated by '|'; a name that starts with '>' makes its column
// flush right.
void rn_text_table_init(struct rn_text_table *table, const char *heading);
// `cells` as a heading is written: "a|b|c" in printf's fashion. What is missing stays empty; the
// last one may hold a '|'.
void rn_text_table_row(struct rn_text_table *table, const char *cells, ...) RN_PRINTF(2, 3);
// Prints heading and rows, or the heading alone; RN_ERROR_NO_MEMORY when a row was lost.
enum rn_status rn_text_table_print(const struct rn_text_table *table,
                                   struct rn_error *err) RN_MUST_CHECK;
void rn_text_table_finish(struct rn_text_table *table);

#endif
