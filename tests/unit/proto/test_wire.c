// The framed protocol: any cutting of the stream, hostile headers, a full pipe.
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "proto/wire_messages.h"
#include "tests/support/suite.h"

static int ends[2];

static void open_pair(void) {
    ck_assert_int_eq(socketpair(AF_UNIX, SOCK_STREAM, 0, ends), 0);
}

static void close_pair(void) {
    close(ends[0]);
    close(ends[1]);
}

// The bytes of one frame.
static struct rn_buf frame_bytes(int type, const char *json, const void *blob, size_t blob_size) {
    struct rn_wire_writer writer;
    rn_wire_writer_init(&writer, -1, 0);
    ck_assert_int_eq(rn_wire_queue(&writer, type, json, strlen(json), blob, blob_size, NULL), 0);
    return writer.pending;
}

START_TEST(frames_cut_anywhere_arrive_whole) {
    struct rn_buf first = frame_bytes(3, "{\"a\":1}", "blob", 4),
                  second = frame_bytes(4, "", "", 0);
    uint8_t bytes[128];
    memcpy(bytes, first.data, first.size);
    memcpy(bytes + first.size, second.data, second.size);
    size_t total = first.size + second.size;
    struct rn_wire_reader reader;
    rn_wire_reader_init(&reader, ends[1]);
    int seen = 0;
    for (size_t at = 0; at < total; at += (size_t)_i) {
        size_t piece = total - at < (size_t)_i ? total - at : (size_t)_i;
        ck_assert_int_eq(write(ends[0], bytes + at, piece), (int)piece);
        bool ready = true;
        while (ready) {
            struct rn_wire_message message;
            ck_assert_int_eq(rn_wire_read(&reader, &ready, &message, NULL), RN_OK);
            if (!ready) break;
            ck_assert_int_eq(message.type, 3 + seen);
            ck_assert_str_eq(message.json, seen ? "" : "{\"a\":1}");
            ck_assert_uint_eq(message.blob_size, seen ? 0 : 4);
            if (!seen) ck_assert_mem_eq(message.blob, "blob", 4);
            rn_wire_message_finish(&message);
            seen++;
        }
    }
    ck_assert_int_eq(seen, 2);
    rn_wire_reader_finish(&reader);
    rn_buf_finish(&first);
    rn_buf_finish(&second);
}
END_TEST

static void expect_error(const uint8_t *bytes, size_t size, enum rn_status expected) {
    struct rn_wire_reader reader;
    rn_wire_reader_init(&reader, ends[1]);
    ck_assert_int_eq(write(ends[0], bytes, size), (int)size);
    struct rn_wire_message message;
    bool ready;
    ck_assert_int_eq(rn_wire_read(&reader, &ready, &message, NULL), expected);
    rn_wire_reader_finish(&reader);
}

START_TEST(garbage_is_refused) {
    expect_error((const uint8_t *)"GET / HTTP/1.1\r\n", 16, RN_ERROR_CORRUPT);
}
END_TEST

START_TEST(sizes_over_the_limit_are_refused_before_allocation) {
    struct rn_buf frame = frame_bytes(1, "{}", NULL, 0);
    frame.data[_i ? 11 : 15] = 0xff; // the highest byte of the JSON's or the blob's size
    expect_error(frame.data, RN_WIRE_HEADER, RN_ERROR_CORRUPT);
    rn_buf_finish(&frame);
}
END_TEST

START_TEST(a_closed_peer_is_unavailable) {
    struct rn_wire_reader reader;
    rn_wire_reader_init(&reader, ends[1]);
    ck_assert_int_eq(write(ends[0], "RN", 2), 2); // in the midst of a header
    shutdown(ends[0], SHUT_WR);
    struct rn_wire_message message;
    bool ready;
    ck_assert_int_eq(rn_wire_read(&reader, &ready, &message, NULL), RN_ERROR_UNAVAILABLE);
    rn_wire_reader_finish(&reader);
    struct rn_wire_writer writer;
    rn_wire_writer_init(&writer, ends[0], 0);
    close(ends[1]);
    ends[1] = -1;
    ck_assert_int_eq(rn_wire_queue(&writer, 1, "{}", 2, NULL, 0, NULL), RN_OK);
    ck_assert_int_eq(rn_wire_drain(&writer, NULL), RN_ERROR_UNAVAILABLE);
    rn_wire_writer_finish(&writer);
}
END_TEST

START_TEST(a_full_pipe_never_blocks_and_loses_nothing) {
    enum { SIZE = 4 << 20 };
    uint8_t *blob = malloc(SIZE);
    for (size_t i = 0; i < SIZE; i++)
        blob[i] = (uint8_t)(i * 31 + (i >> 8));
    struct rn_wire_writer writer;
    struct rn_wire_reader reader;
    rn_wire_writer_init(&writer, ends[0], 0);
    rn_wire_reader_init(&reader, ends[1]);
    ck_assert_int_eq(rn_wire_queue(&writer, RN_WIRE_RENDERED, "{}", 2, blob, SIZE, NULL), RN_OK);
    bool empty, ready = false;
    ck_assert_int_eq(rn_wire_flush(&writer, &empty, NULL), RN_OK);
    ck_assert(!empty);
    struct rn_wire_message message;
    while (!ready) {
        ck_assert_int_eq(rn_wire_read(&reader, &ready, &message, NULL), RN_OK);
        ck_assert_int_eq(rn_wire_flush(&writer, &empty, NULL), RN_OK);
    }
    ck_assert(empty);
    ck_assert_uint_eq(message.blob_size, SIZE);
    ck_assert_mem_eq(message.blob, blob, SIZE);
    rn_wire_message_finish(&message);
    rn_wire_writer_finish(&writer);
    rn_wire_reader_finish(&reader);
    free(blob);
}
END_TEST

START_TEST(the_queue_is_bounded) {
    struct rn_wire_writer writer;
    rn_wire_writer_init(&writer, ends[0], 100);
    char json[60];
    memset(json, ' ', sizeof json);
    ck_assert_int_eq(rn_wire_queue(&writer, 1, json, sizeof json, NULL, 0, NULL), RN_OK);
    ck_assert_int_eq(rn_wire_queue(&writer, 1, json, sizeof json, NULL, 0, NULL), RN_ERROR_LIMIT);
    ck_assert_uint_eq(writer.pending.size, RN_WIRE_HEADER + sizeof json);
    rn_wire_writer_finish(&writer);
}
END_TEST

START_TEST(messages_survive_the_trip) {
    struct rn_wire_writer writer;
    struct rn_wire_reader reader;
    rn_wire_writer_init(&writer, ends[0], 0);
    rn_wire_reader_init(&reader, ends[1]);
    struct rn_wire_train train = {.job = "job_aaaaaaaaaaaa"}, again;
    rn_message_init(&rn_train_options_table, &train.options);
    rn_settings_value(&rn_train_settings, train.options.settings, "max_steps")->whole = 12;
    ck_assert_int_eq(rn_wire_post(&writer, RN_WIRE_TRAIN, &train, NULL, 0, NULL), RN_OK);
    ck_assert_int_eq(rn_wire_drain(&writer, NULL), RN_OK);
    struct rn_wire_message message;
    bool ready;
    ck_assert_int_eq(rn_wire_read(&reader, &ready, &message, NULL), RN_OK);
    ck_assert(ready);
    ck_assert_int_eq(message.type, RN_WIRE_TRAIN);
    ck_assert_int_eq(rn_wire_take(&message, &again, NULL), RN_OK);
    ck_assert_str_eq(again.job, train.job);
    ck_assert_int_eq(
        rn_settings_value(&rn_train_settings, again.options.settings, "max_steps")->whole, 12);
    ck_assert_int_eq(rn_settings_value(&rn_train_settings, again.options.settings, "planes")->whole,
                     RN_ABSENT);
    rn_message_finish(rn_wire_table(RN_WIRE_TRAIN), &again);
    message.type = 99;
    ck_assert_int_eq(rn_wire_take(&message, &again, NULL), RN_ERROR_INVALID);
    rn_wire_message_finish(&message);
    rn_wire_writer_finish(&writer);
    rn_wire_reader_finish(&reader);
}
END_TEST

int main(void) {
    TCase *tests = tcase_create("wire");
    tcase_add_checked_fixture(tests, open_pair, close_pair);
    tcase_add_loop_test(tests, frames_cut_anywhere_arrive_whole, 1, 50);
    tcase_add_test(tests, garbage_is_refused);
    tcase_add_loop_test(tests, sizes_over_the_limit_are_refused_before_allocation, 0, 2);
    tcase_add_test(tests, a_closed_peer_is_unavailable);
    tcase_add_test(tests, a_full_pipe_never_blocks_and_loses_nothing);
    tcase_add_test(tests, the_queue_is_bounded);
    tcase_add_test(tests, messages_survive_the_trip);
    Suite *suite = suite_create("proto");
    suite_add_tcase(suite, tests);
    return run_suite(suite);
}
