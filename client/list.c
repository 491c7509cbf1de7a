// Collections, page by page.

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "client/api.h"

#define ITEMS_PER_PAGE 200
#define PAGE_MAX 10000 // pages; a cursor that never ends is not followed further

// A page of any collection, its items kept as one JSON array.
struct page {
    void *items;
    size_t count;
    char next_cursor[129];
};

// What the pages add up to: the items' JSON texts for --json, else rows.
struct gathered {
    char **texts;
    size_t count, capacity;
    struct rn_text_table rows;
};

static bool gather(struct gathered *gathered, char *text) {
    if (text && gathered->count == gathered->capacity) {
        size_t capacity = gathered->capacity ? 2 * gathered->capacity : 64;
        char **texts = realloc(gathered->texts, capacity * sizeof *texts);
        if (!texts) {
            free(text);
            return false;
        }
        gathered->texts = texts;
        gathered->capacity = capacity;
    }
    if (text) gathered->texts[gathered->count++] = text;
    return text != NULL;
}

static enum rn_exit take_items(struct rn_client *client, const struct rn_api_list *list,
                               const struct page *page, struct gathered *gathered) {
    for (size_t i = 0; i < page->count; i++) {
        const void *item = (const char *)page->items + i * list->table->size;
        if (!client->json)
            list->row(&gathered->rows, item);
        else if (!gather(gathered, rn_api_encode(list->table, item)))
            return RN_EXIT_FAILED;
    }
    return RN_EXIT_OK;
}

// Reads one page; `cursor` is "" for the first and becomes that of the next, "" after the last.
static enum rn_exit take_page(struct rn_client *client, const struct rn_api_list *list,
                              char cursor[129], struct gathered *gathered) {
    const struct rn_field_spec fields[] = {
        RN_F_OBJECTS(struct page, items, count, RN_REQUIRED, list->table, ITEMS_PER_PAGE),
        RN_F_TEXT(struct page, next_cursor, RN_REQUIRED | RN_NULLABLE, NULL)};
    const struct rn_table table = RN_TABLE(struct page, "a list", fields);
    struct rn_buf path;
    struct rn_api_reply reply;
    struct page page;
    rn_buf_init(&path, 1024);
    rn_buf_printf(&path, "/v1/%s?limit=%d%s%s", rn_api_collection(list->kind), ITEMS_PER_PAGE,
                  list->query ? list->query : "", *cursor ? "&cursor=" : "");
    rn_http_escape(&path, cursor);
    rn_api_send(client, "GET", path.failed ? "/" : (char *)path.data, NULL, &reply);
    rn_buf_finish(&path);
    enum rn_exit code =
        reply.code == RN_EXIT_OK ? rn_api_decode(&reply, &table, &page) : rn_api_complain(&reply);
    if (code == RN_EXIT_OK) {
        memcpy(cursor, page.next_cursor, sizeof page.next_cursor);
        code = take_items(client, list, &page, gathered);
        rn_message_finish(&table, &page);
    }
    rn_api_reply_finish(&reply);
    return code;
}

static enum rn_exit print_list(const struct gathered *gathered) {
    struct rn_error err = {0};
    char *json = NULL;
    if (rn_encode_list((const char *const *)gathered->texts, gathered->count, NULL, &json, NULL,
                       &err) != RN_OK)
        return rn_client_fail(&err);
    puts(json);
    free(json);
    return RN_EXIT_OK;
}

enum rn_exit rn_api_print_list(struct rn_client *client, const struct rn_api_list *list) {
    struct gathered gathered = {0};
    struct rn_error err = {0};
    char cursor[129] = "";
    enum rn_exit code = RN_EXIT_OK;
    rn_text_table_init(&gathered.rows, list->heading);
    for (int pages = 0; code == RN_EXIT_OK && (pages == 0 || *cursor) && pages < PAGE_MAX; pages++)
        code = take_page(client, list, cursor, &gathered);
    if (code == RN_EXIT_OK && client->json)
        code = print_list(&gathered);
    else if (code == RN_EXIT_OK && rn_text_table_print(&gathered.rows, &err) != RN_OK)
        code = rn_client_fail(&err);
    for (size_t i = 0; i < gathered.count; i++)
        free(gathered.texts[i]);
    free(gathered.texts);
    rn_text_table_finish(&gathered.rows);
    return code;
}
