#include "client/table.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void add_row(struct rn_text_table *table, const char *text) {
    if (table->rows == table->capacity) {
        size_t capacity = table->capacity ? 2 * table->capacity : 16;
        void *cells = realloc(table->cells, capacity * table->columns * RN_TEXT_TABLE_CELL);
        if (!cells) {
            table->failed = true;
            return;
        }
        table->cells = cells;
        table->capacity = capacity;
    }
    char(*row)[RN_TEXT_TABLE_CELL] = table->cells + table->rows++ * table->columns;
    memset(row, 0, table->columns * RN_TEXT_TABLE_CELL);
    for (size_t i = 0; i < table->columns; i++) {
        size_t size = i + 1 < table->columns ? strcspn(text, "|") : strlen(text);
        snprintf(row[i], RN_TEXT_TABLE_CELL, "%.*s", (int)size, text);
        text += size + (text[size] == '|');
    }
}

void rn_text_table_init(struct rn_text_table *table, const char *heading) {
    memset(table, 0, sizeof *table);
    table->columns = 1;
    for (const char *c = heading; *c; c++)
        table->columns += *c == '|';
    add_row(table, heading);
}

void rn_text_table_row(struct rn_text_table *table, const char *cells, ...) {
    char text[RN_TEXT_TABLE_MAX_COLUMNS * RN_TEXT_TABLE_CELL];
    va_list args;
    va_start(args, cells);
    vsnprintf(text, sizeof text, cells, args);
    va_end(args);
    add_row(table, text);
}

// Characters, not bytes: UTF-8's continuation bytes take no room.
static int width_of(const char *text) {
    int width = 0;
    for (; *text; text++)
        width += ((unsigned char)*text & 0xc0) != 0x80;
    return width;
}

static void print_cell(const char *text, int width, bool right, bool last) {
    int padding = width - width_of(text);
    if (right)
        printf("%*s%s", padding, "", text);
    else
        printf("%s%*s", text, last ? 0 : padding, "");
    fputs(last ? "\n" : "  ", stdout);
}

enum rn_status rn_text_table_print(const struct rn_text_table *table, struct rn_error *err) {
    if (table->failed) return rn_error_set(err, RN_ERROR_NO_MEMORY, "table", "memory ran out");
    int widths[RN_TEXT_TABLE_MAX_COLUMNS] = {0};
    for (size_t i = 0; i < table->rows * table->columns; i++) {
        int width = width_of(table->cells[i]) - (table->cells[i][0] == '>' && i < table->columns);
        if (width > widths[i % table->columns]) widths[i % table->columns] = width;
    }
    for (size_t i = 0; i < table->rows * table->columns; i++) {
        size_t column = i % table->columns;
        bool right = table->cells[column][0] == '>';
        print_cell(table->cells[i] + (i < table->columns && right), widths[column], right,
                   column + 1 == table->columns);
    }
    return RN_OK;
}

void rn_text_table_finish(struct rn_text_table *table) {
    free(table->cells);
    memset(table, 0, sizeof *table);
}
