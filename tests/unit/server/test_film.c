// Films are decoded again: their size, rate, number of frames and colours.
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libswscale/swscale.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "server/film/film.h"
#include "tests/support/suite.h"

enum { FRAMES = 9 };
#define FPS 12.5

static const struct rn_film_module *const module = &rn_film_module;
static char file[64];

// Flat colour that moves through the cube, with a white bar at the left.
static void draw(uint8_t *pixels, int width, int height, int frame) {
    for (int i = 0; i < width * height; i++) {
        bool bar = i % width < width / 4;
        pixels[4 * i] = (uint8_t)(bar ? 255 : 20 + 25 * frame);
        pixels[4 * i + 1] = (uint8_t)(bar ? 255 : 230 - 25 * frame);
        pixels[4 * i + 2] = (uint8_t)(bar ? 255 : 90);
        pixels[4 * i + 3] = 255;
    }
}

static enum rn_status make(enum rn_film_codec codec, int width, int height, int quality) {
    struct rn_film_spec spec = {.file = file,
                                .codec = codec,
                                .width = width,
                                .height = height,
                                .fps = FPS,
                                .quality = quality,
                                .threads = 1};
    struct rn_film *film = NULL;
    int passes = 0;
    snprintf(file, sizeof file, "film_test_%d.%s", (int)getpid(),
             codec == RN_FILM_GIF   ? "gif"
             : codec == RN_FILM_VP9 ? "webm"
                                    : "mp4");
    uint8_t *pixels = malloc((size_t)(width * height * 4));
    enum rn_status status = module->open(&spec, &film, &passes, NULL);
    for (int pass = 0; pass < passes && !status; pass++) {
        for (int i = 0; i < FRAMES && !status; i++) {
            draw(pixels, width, height, i);
            status = module->add(film, pixels, NULL);
        }
        if (!status) status = module->end_pass(film, NULL);
    }
    if (film) module->close(&film);
    free(pixels);
    return status;
}

struct seen {
    int width, height, frames;
    double fps, error; // the largest difference of a frame's middle and bar from what was drawn
};

static double differs(const uint8_t *rgb, int stride, const struct seen *seen, int frame) {
    const uint8_t *middle = rgb + seen->height / 2 * stride + 3 * (seen->width * 5 / 8);
    const uint8_t *bar = rgb + seen->height / 2 * stride + 3 * (seen->width / 8);
    const int wanted[3] = {20 + 25 * frame, 230 - 25 * frame, 90};
    double worst = 0;
    for (int i = 0; i < 3; i++) {
        worst = fmax(worst, abs(middle[i] - wanted[i]));
        worst = fmax(worst, abs(bar[i] - 255));
    }
    return worst;
}

static void take(struct seen *seen, struct SwsContext **scale, const AVFrame *frame) {
    int width = frame->width, height = frame->height;
    uint8_t *rgb = malloc((size_t)(3 * width * height)), *rows[] = {rgb};
    const int strides[] = {3 * width};
    *scale =
        sws_getCachedContext(*scale, width, height, frame->format, width, height, AV_PIX_FMT_RGB24,
                             SWS_BICUBIC | SWS_ACCURATE_RND, NULL, NULL, NULL);
    const int *bt709 = sws_getCoefficients(SWS_CS_ITU709);
    sws_setColorspaceDetails(*scale, bt709, 0, bt709, 1, 0, 1 << 16, 1 << 16);
    sws_scale(*scale, (const uint8_t *const *)frame->data, frame->linesize, 0, height, rows,
              strides);
    seen->width = width;
    seen->height = height;
    seen->error = fmax(seen->error, differs(rgb, strides[0], seen, seen->frames++));
    free(rgb);
}

static struct seen look(void) {
    struct seen seen = {0};
    AVFormatContext *in = NULL;
    struct SwsContext *scale = NULL;
    AVPacket *packet = av_packet_alloc();
    AVFrame *frame = av_frame_alloc();
    ck_assert_int_eq(avformat_open_input(&in, file, NULL, NULL), 0);
    ck_assert_int_ge(avformat_find_stream_info(in, NULL), 0);
    AVStream *stream = in->streams[0];
    const AVCodec *decoder = avcodec_find_decoder(stream->codecpar->codec_id);
    AVCodecContext *codec = avcodec_alloc_context3(decoder);
    avcodec_parameters_to_context(codec, stream->codecpar);
    ck_assert_int_eq(avcodec_open2(codec, decoder, NULL), 0);
    seen.fps = av_q2d(stream->avg_frame_rate);
    for (bool more = true; more;) {
        more = av_read_frame(in, packet) >= 0;
        if (avcodec_send_packet(codec, more ? packet : NULL) < 0 && more) ck_abort();
        av_packet_unref(packet);
        while (avcodec_receive_frame(codec, frame) >= 0)
            take(&seen, &scale, frame);
    }
    sws_freeContext(scale);
    avcodec_free_context(&codec);
    avformat_close_input(&in);
    av_frame_free(&frame);
    av_packet_free(&packet);
    unlink(file);
    return seen;
}

static void expect(enum rn_film_codec codec, int width, int height, double most) {
    enum rn_status status = make(codec, width, height, 90);
    if (status == RN_ERROR_UNSUPPORTED) return; // said by the library: no such encoder
    ck_assert_int_eq(status, RN_OK);
    struct seen seen = look();
    bool gif = codec == RN_FILM_GIF;
    ck_assert_int_eq(seen.width, gif ? width : width & ~1);
    ck_assert_int_eq(seen.height, gif ? height : height & ~1);
    ck_assert_int_eq(seen.frames, FRAMES);
    ck_assert_double_eq_tol(seen.fps, FPS, gif ? 0.3 : 1e-3);
    ck_assert_msg(seen.error <= most, "codec %d: colours differ by %g", codec, seen.error);
}

START_TEST(h264_shows_what_was_drawn) {
    expect(RN_FILM_H264, 64, 48, 5);
    expect(RN_FILM_H264, 65, 47, 5);
}
END_TEST

START_TEST(av1_shows_what_was_drawn) {
    expect(RN_FILM_AV1, 64, 64, 6);
    expect(RN_FILM_AV1, 50, 30, 6); // smaller than one of the encoders takes
}
END_TEST

START_TEST(vp9_shows_what_was_drawn) {
    expect(RN_FILM_VP9, 64, 48, 6);
}
END_TEST

START_TEST(gif_shows_what_was_drawn) {
    expect(RN_FILM_GIF, 65, 47, 10);
}
END_TEST

static long size_at(enum rn_film_codec codec, int quality) {
    struct stat about;
    ck_assert_int_eq(make(codec, 128, 96, quality), RN_OK);
    ck_assert_int_eq(stat(file, &about), 0);
    unlink(file);
    return (long)about.st_size;
}

START_TEST(quality_costs_bytes) {
    long low = size_at(RN_FILM_H264, 0), high = size_at(RN_FILM_H264, 100);
    ck_assert_msg(low < high, "%ld and %ld bytes", low, high);
}
END_TEST

START_TEST(what_no_encoder_takes_is_refused) {
    ck_assert_int_eq(make(RN_FILM_H264, 1, 5, 50), RN_ERROR_INVALID);
    struct rn_film_spec spec = {
        .file = "/nowhere/at/all.mp4", .codec = RN_FILM_H264, .width = 16, .height = 16, .fps = 1};
    struct rn_film *film = NULL;
    struct rn_error err = {0};
    int passes;
    ck_assert_int_ne(module->open(&spec, &film, &passes, &err), RN_OK);
    ck_assert_ptr_null(film);
    ck_assert_str_ne(err.text, "");
}
END_TEST

START_TEST(a_full_disk_is_told) { // /dev/full takes nothing
    struct rn_film_spec spec = {.file = "/dev/full",
                                .codec = RN_FILM_VP9,
                                .width = 64,
                                .height = 48,
                                .fps = 10,
                                .quality = 100};
    struct rn_film *film = NULL;
    struct rn_error err = {0};
    uint8_t pixels[64 * 48 * 4];
    int passes;
    enum rn_status status = module->open(&spec, &film, &passes, &err);
    for (int i = 0; i < FRAMES && !status; i++) {
        draw(pixels, 64, 48, i);
        status = module->add(film, pixels, &err);
    }
    if (!status) status = module->end_pass(film, &err);
    ck_assert_int_eq(status, RN_ERROR_NO_SPACE);
    if (film) module->close(&film);
}
END_TEST

int main(void) {
    Suite *suite = suite_create("film");
    TCase *films = tcase_create("films");
    tcase_set_timeout(films, 60);
    suite_add_tcase(suite, films);
    tcase_add_test(films, h264_shows_what_was_drawn);
    tcase_add_test(films, av1_shows_what_was_drawn);
    tcase_add_test(films, vp9_shows_what_was_drawn);
    tcase_add_test(films, gif_shows_what_was_drawn);
    tcase_add_test(films, quality_costs_bytes);
    tcase_add_test(films, what_no_encoder_takes_is_refused);
    tcase_add_test(films, a_full_disk_is_told);
    return run_suite(suite);
}
