// Films by FFmpeg's libraries: H.264 and AV1 in MP4, VP9 in WebM, GIF.
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
#include <libavutil/opt.h>
#include <libswscale/swscale.h>

#include "server/film/film.h"
#include "server/film/palette.h"

// An encoder and what it is told; crf_best and crf_worst are the qualities 100 and 0.
struct encoder {
    enum rn_film_codec codec;
    const char *name, *container;
    int crf_best, crf_worst;
    const char *options[3][2];
};

// In order of preference within a codec.
static const struct encoder encoders[] = {
    {RN_FILM_H264, "libx264", "mp4", 12, 40, {{"preset", "medium"}}},
    {RN_FILM_AV1, "libsvtav1", "mp4", 15, 60, {{"preset", "8"}}},
    {RN_FILM_AV1, "libaom-av1", "mp4", 15, 60, {{"cpu-used", "6"}, {"row-mt", "1"}}},
    {RN_FILM_VP9,
     "libvpx-vp9",
     "webm",
     15,
     58,
     {{"cpu-used", "4"}, {"row-mt", "1"}, {"deadline", "good"}}},
    {RN_FILM_GIF, "gif", "gif", 0, 0, {{NULL}}},
};

struct rn_film {
    struct rn_film_spec spec;
    const struct encoder *encoder;
    AVFormatContext *container;
    AVCodecContext *codec;
    AVStream *stream;
    AVFrame *frame;   // what the encoder takes
    AVPacket *packet; // what it gives
    struct SwsContext *scale;
    struct rn_palette *palette; // GIF
    int64_t frames;             // encoded
    bool first_pass;            // of GIF: colours are counted
};

static enum rn_status fail(int code, const char *what, struct rn_error *err) {
    char text[AV_ERROR_MAX_STRING_SIZE] = "";
    if (code == AVERROR(ENOMEM)) return rn_error_set(err, RN_ERROR_NO_MEMORY, "film", "no memory");
    av_strerror(code, text, sizeof text);
    if (code == AVERROR(ENOSPC))
        return rn_error_set(
            err, RN_ERROR_NO_SPACE, "film",
            "no space is left on the disk; the frames are kept, make room and ask again");
    enum rn_status status = code == AVERROR(EIO) ? RN_ERROR_IO : RN_ERROR_INVALID;
    return rn_error_set(err, status, "film", "%s: %s", what, text);
}

// ---- opening ----------------------------------------------------------------------------------

static void set_colours(AVCodecContext *codec) { // BT.709, as players take video of any size
    codec->color_primaries = AVCOL_PRI_BT709;
    codec->color_trc = AVCOL_TRC_BT709;
    codec->colorspace = AVCOL_SPC_BT709;
    codec->color_range = AVCOL_RANGE_MPEG;
}

static int open_encoder(struct rn_film *film, const AVCodec *found) {
    const struct rn_film_spec *spec = &film->spec;
    const struct encoder *e = film->encoder;
    bool gif = e->codec == RN_FILM_GIF;
    AVCodecContext *codec = film->codec = avcodec_alloc_context3(found);
    if (!codec) return AVERROR(ENOMEM);
    codec->width = gif ? spec->width : spec->width & ~1;
    codec->height = gif ? spec->height : spec->height & ~1;
    codec->framerate = av_d2q(spec->fps, 100000);
    codec->time_base = gif ? (AVRational){1, 100} : av_inv_q(codec->framerate);
    codec->pix_fmt = gif ? AV_PIX_FMT_PAL8 : AV_PIX_FMT_YUV420P;
    codec->thread_count = spec->threads;
    codec->flags |= AV_CODEC_FLAG_BITEXACT;
    if (film->container->oformat->flags & AVFMT_GLOBALHEADER)
        codec->flags |= AV_CODEC_FLAG_GLOBAL_HEADER;
    if (!gif) {
        int crf = e->crf_worst + ((e->crf_best - e->crf_worst) * spec->quality - 50) / 100;
        set_colours(codec);
        av_opt_set_int(codec->priv_data, "crf", crf, 0);
    }
    for (int i = 0; i < 3 && e->options[i][0]; i++)
        av_opt_set(codec->priv_data, e->options[i][0], e->options[i][1], 0);
    return avcodec_open2(codec, found, NULL);
}

static int open_container(struct rn_film *film) {
    char url[4200];
    AVDictionary *options = NULL;
    film->stream = avformat_new_stream(film->container, NULL);
    if (!film->stream) return AVERROR(ENOMEM);
    film->stream->time_base = film->codec->time_base;
    film->stream->avg_frame_rate = film->codec->framerate;
    int code = avcodec_parameters_from_context(film->stream->codecpar, film->codec);
    if (code < 0) return code;
    snprintf(url, sizeof url, "file:%s", film->spec.file);
    if ((code = avio_open(&film->container->pb, url, AVIO_FLAG_WRITE)) < 0) return code;
    film->container->flags |= AVFMT_FLAG_BITEXACT;
    if (strcmp(film->encoder->container, "mp4") == 0)
        av_dict_set(&options, "movflags", "+faststart", 0);
    code = avformat_write_header(film->container, &options);
    av_dict_free(&options);
    return code < 0 ? code : 0;
}

static int open_frame(struct rn_film *film) {
    const AVCodecContext *codec = film->codec;
    film->frame = av_frame_alloc();
    film->packet = av_packet_alloc();
    if (!film->frame || !film->packet) return AVERROR(ENOMEM);
    film->frame->format = codec->pix_fmt;
    film->frame->width = codec->width;
    film->frame->height = codec->height;
    int code = av_frame_get_buffer(film->frame, 0);
    if (code < 0 || codec->pix_fmt == AV_PIX_FMT_PAL8) return code;
    film->scale = sws_getContext(
        codec->width, codec->height, AV_PIX_FMT_RGBA, codec->width, codec->height, codec->pix_fmt,
        SWS_BICUBIC | SWS_ACCURATE_RND | SWS_FULL_CHR_H_INT, NULL, NULL, NULL);
    if (!film->scale) return AVERROR(ENOMEM);
    const int *bt709 = sws_getCoefficients(SWS_CS_ITU709);
    return sws_setColorspaceDetails(film->scale, bt709, 1, bt709, 0, 0, 1 << 16, 1 << 16) < 0
               ? AVERROR(EINVAL)
               : 0;
}

static void close_film(struct rn_film **film) {
    struct rn_film *f = *film;
    if (!f) return;
    if (f->container && f->container->pb) avio_closep(&f->container->pb);
    avformat_free_context(f->container);
    avcodec_free_context(&f->codec);
    av_frame_free(&f->frame);
    av_packet_free(&f->packet);
    sws_freeContext(f->scale);
    rn_palette_destroy(&f->palette);
    free(f);
    *film = NULL;
}

static int try_encoder(const struct rn_film_spec *spec, const struct encoder *encoder,
                       struct rn_film **ret_film) {
    const AVCodec *found = avcodec_find_encoder_by_name(encoder->name);
    if (!found) return AVERROR_ENCODER_NOT_FOUND;
    struct rn_film *film = calloc(1, sizeof *film);
    if (!film) return AVERROR(ENOMEM);
    film->spec = *spec;
    film->encoder = encoder;
    int code =
        avformat_alloc_output_context2(&film->container, NULL, encoder->container, spec->file);
    if (code >= 0) code = open_encoder(film, found);
    if (code >= 0) code = open_container(film);
    if (code >= 0) code = open_frame(film);
    if (code >= 0 && encoder->codec == RN_FILM_GIF) {
        film->first_pass = true;
        film->palette = rn_palette_create(spec->width, spec->height, 16 + spec->quality * 12 / 5);
        if (!film->palette) code = AVERROR(ENOMEM);
    }
    if (code < 0)
        close_film(&film);
    else
        *ret_film = film;
    return code;
}

static enum rn_status open_film(const struct rn_film_spec *spec, struct rn_film **ret_film,
                                int *ret_passes, struct rn_error *err) {
    int code = AVERROR_ENCODER_NOT_FOUND;
    setenv("SVT_LOG", "1", 0); // errors alone
    av_log_set_level(AV_LOG_FATAL);
    if (spec->codec != RN_FILM_GIF && (spec->width < 2 || spec->height < 2))
        return rn_error_set(err, RN_ERROR_INVALID, "film",
                            "a video has at least 2 x 2 pixels; these frames have %d x %d",
                            spec->width, spec->height);
    for (size_t i = 0; i < sizeof encoders / sizeof *encoders && code < 0; i++)
        if (encoders[i].codec == spec->codec) {
            int now = try_encoder(spec, &encoders[i], ret_film);
            if (now != AVERROR_ENCODER_NOT_FOUND || code == AVERROR_ENCODER_NOT_FOUND) code = now;
        }
    if (code == AVERROR_ENCODER_NOT_FOUND)
        return rn_error_set(err, RN_ERROR_UNSUPPORTED, "film",
                            "FFmpeg's libraries here have no encoder of this kind");
    if (code < 0) return fail(code, "the encoder does not take these frames", err);
    *ret_passes = spec->codec == RN_FILM_GIF ? 2 : 1;
    return RN_OK;
}

// ---- frames -----------------------------------------------------------------------------------

// Sends a frame, or with NULL the end, and writes what the encoder gives.
static enum rn_status encode(struct rn_film *film, AVFrame *frame, struct rn_error *err) {
    int code = avcodec_send_frame(film->codec, frame);
    while (code >= 0) {
        code = avcodec_receive_packet(film->codec, film->packet);
        if (code == AVERROR(EAGAIN) || code == AVERROR_EOF) return RN_OK;
        if (code < 0) break;
        film->packet->stream_index = film->stream->index;
        if (film->packet->duration == 0 && film->encoder->codec != RN_FILM_GIF)
            film->packet->duration = 1;
        av_packet_rescale_ts(film->packet, film->codec->time_base, film->stream->time_base);
        code = av_interleaved_write_frame(film->container, film->packet);
        if (code >= 0 && film->container->pb->error < 0) code = film->container->pb->error;
    }
    return fail(code, "writing the film", err);
}

// A GIF counts in hundredths of a second.
static int64_t time_of(const struct rn_film *film, int64_t frame) {
    if (film->encoder->codec != RN_FILM_GIF) return frame;
    return (int64_t)((double)frame * 100 / film->spec.fps + 0.5);
}

static enum rn_status add(struct rn_film *film, const uint8_t *pixels, struct rn_error *err) {
    if (film->first_pass) {
        rn_palette_count(film->palette, pixels);
        return RN_OK;
    }
    int code = av_frame_make_writable(film->frame);
    if (code < 0) return fail(code, "the next frame", err);
    const uint8_t *rows[] = {pixels};
    const int strides[] = {4 * film->spec.width};
    if (film->palette)
        rn_palette_apply(film->palette, pixels, film->frame->data[0], film->frame->linesize[0],
                         (uint32_t *)(void *)film->frame->data[1]);
    else
        sws_scale(film->scale, rows, strides, 0, film->codec->height, film->frame->data,
                  film->frame->linesize);
    film->frame->pts = time_of(film, film->frames++);
    film->frame->pict_type = AV_PICTURE_TYPE_NONE;
    return encode(film, film->frame, err);
}

static enum rn_status end_pass(struct rn_film *film, struct rn_error *err) {
    if (film->first_pass) {
        film->first_pass = false;
        rn_palette_choose(film->palette);
        return RN_OK;
    }
    enum rn_status status = encode(film, NULL, err);
    if (status != RN_OK) return status;
    int code = av_write_trailer(film->container);
    if (code >= 0) code = avio_closep(&film->container->pb);
    return code < 0 ? fail(code, "closing the film", err) : RN_OK;
}

const struct rn_film_module rn_film_module = {.version = RN_FILM_VERSION,
                                              .open = open_film,
                                              .add = add,
                                              .end_pass = end_pass,
                                              .close = close_film};
