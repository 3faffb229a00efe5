/* A camera under the V4L2 interface without a kernel driver: preloaded, it answers open, ioctl, mmap, poll and close for
 * the file FAKE_V4L2 as videobuf2 and uvcvideo do for /dev/videoN, and misbehaves as they may. Written from the kernel's
 * description of the API (userspace-api/media/v4l), not from the driver that is tested with it.
 *
 * The same name with .state added is a block of 64-bit numbers, shared with the test: see the names below and fake_v4l2.py.
 * A frame shows, each 16 bits across: in its first and last row the frame's number, in the last but one the gain and in the
 * one above the exposure that it was taken with, in the upper quarter the light that was on at the start and in the next
 * quarter the one at the end of its exposure. The lower half is as bright as the part of the exposure in which a light
 * with an odd number was on (10 % to 90 % of the highest count). Of a torn frame the lower half is what the buffer held. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <poll.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

enum { WIDTH, HEIGHT, BITS, PERIOD_NS, LATENCY_NS, JITTER_NS, DROPPED_PER_1000, STALLED, UNPLUGGED, BUSY, STAMP, LIES,
       SEED, EXPOSED, LIGHTS, FORBIDDEN,
       LATE_EVERY, LATE_NS,      /* every so many frames a time stamp is so late */
       ZERO_EVERY,               /* ... or zero */
       ERROR_EVERY,              /* ... or a frame is torn and has V4L2_BUF_FLAG_ERROR */
       SHORT_EVERY,              /* ... or is torn, and bytesused says half */
       JUMP_EVERY, JUMP_BY,      /* ... or the count jumps, frames having been lost before the computer */
       EIO_EVERY,                /* every so many VIDIOC_DQBUF fail and keep their buffer */
       EAGAIN_EVERY,             /* ... or find no buffer after poll said that there was one */
       BROKEN,                   /* the stream has ended with an error; VIDIOC_STREAMOFF mends it */
       BURST,                    /* frames are delivered so many at a time */
       LINE_PADDING,             /* bytes after each line */
       INTERLACED,
       FIRST_SEQUENCE, STUCK,    /* where the count begins; whether it stands still */
       NO_ROOM,                  /* VIDIOC_STREAMON: ENOSPC */
       BUFFERS_LEAST, BUFFERS_MOST,
       CLAMPS,                   /* controls take the nearest value instead of refusing; exposures are rounded to 10 */
       AUTO_STAYS,               /* automatic exposure takes every value and stays on */
       CREEPS,                   /* so many frames after it was set the exposure is another */
       CONTROL_LATENCY,          /* frames after a control was set that still have its old value */
       ALL_FORMATS, OPEN_ERROR, QUERY_ERROR, CAPABILITIES, MAPPED, DROPPED,
       NEW_KIND,                 /* a control is of a kind that only newer kernels have */
       RESPONDS,                 /* the lower half is as bright as the exposure is long, 30 ms being full */
       PATIENT,                  /* begins no exposure before there is a buffer for it: loses no frame to a slow program */
      
       FIRST_LIGHT = 64, RING = 1024, STATE_LENGTH = FIRST_LIGHT + 2 * RING };
enum { START_OF_EXPOSURE, END_OF_FRAME, UNKNOWN_CLOCK };
enum { BUFFERS = 32, FDS = 1024, REMEMBERED = 64, BURSTS = 16, COOKIE_BITS = 24 };

static int (*real_open)(const char *, int, ...);
static int (*real_ioctl)(int, unsigned long, ...);
static int (*real_close)(int);
static int (*real_poll)(struct pollfd *, nfds_t, int);
static int (*real_munmap)(void *, size_t);
static void *(*real_mmap)(void *, size_t, int, int, int, off_t);

static volatile int64_t *state;
static char ours[FDS];                      /* which descriptors are the device's */
static int owner = -1;                      /* the one that has the buffers */
static pthread_mutex_t turn = PTHREAD_MUTEX_INITIALIZER;
static pthread_t streamer;
static volatile int streaming;
static unsigned buffers, queued[BUFFERS], done, dequeued, filled[BUFFERS];
static volatile unsigned waiting;
static struct v4l2_buffer slots[BUFFERS];
static unsigned char *memory[BUFFERS];
static char mapped[BUFFERS];

enum layout { BYTE, LITTLE, BIG, YUYV, MIPI10, MIPI12, PACKED10 };
struct format { uint32_t fourcc; enum layout layout; int bits; const char *colours; };
static const struct format formats[] = {    /* bits 0: as many as the camera has */
    {V4L2_PIX_FMT_YUYV, YUYV, 8, "GGGG"}, {V4L2_PIX_FMT_GREY, BYTE, 8, "GGGG"}, {V4L2_PIX_FMT_Y16, LITTLE, 0, "GGGG"},
    {V4L2_PIX_FMT_Y16_BE, BIG, 0, "GGGG"}, {V4L2_PIX_FMT_Y10, LITTLE, 10, "GGGG"}, {V4L2_PIX_FMT_Y12, LITTLE, 12, "GGGG"},
    {V4L2_PIX_FMT_Y10P, MIPI10, 10, "GGGG"}, {v4l2_fourcc('Y', '1', '2', 'P'), MIPI12, 12, "GGGG"},
    {V4L2_PIX_FMT_Y10BPACK, PACKED10, 10, "GGGG"}, {V4L2_PIX_FMT_SBGGR8, BYTE, 8, "BGGR"},
    {V4L2_PIX_FMT_SRGGB8, BYTE, 8, "RGGB"}, {V4L2_PIX_FMT_SGRBG10, LITTLE, 10, "GRBG"},
    {V4L2_PIX_FMT_SGBRG12, LITTLE, 12, "GBRG"}, {V4L2_PIX_FMT_SRGGB16, LITTLE, 0, "RGGB"},
    {V4L2_PIX_FMT_SRGGB10P, MIPI10, 10, "RGGB"}, {V4L2_PIX_FMT_SGBRG12P, MIPI12, 12, "GBRG"},
    {V4L2_PIX_FMT_MJPEG, BYTE, 8, "GGGG"},
};
static const struct format *format = formats;

struct control { uint32_t id, type; const char *name; int32_t least, most, preset, value; };
static struct control controls[] = {
    {V4L2_CTRL_CLASS_USER | 1, V4L2_CTRL_TYPE_CTRL_CLASS, "User Controls", 0, 0, 0, 0},
    {V4L2_CID_BRIGHTNESS, V4L2_CTRL_TYPE_INTEGER, "Brightness", -64, 64, 0, 0},
    {V4L2_CID_AUTO_WHITE_BALANCE, V4L2_CTRL_TYPE_BOOLEAN, "White Balance, Automatic", 0, 1, 1, 1},
    {V4L2_CID_GAIN, V4L2_CTRL_TYPE_INTEGER, "Gain", 16, 255, 16, 16},
    {V4L2_CTRL_CLASS_CAMERA | 1, V4L2_CTRL_TYPE_CTRL_CLASS, "Camera Controls", 0, 0, 0, 0},
    {V4L2_CID_EXPOSURE_AUTO, V4L2_CTRL_TYPE_MENU, "Auto Exposure", 0, 3, 3, 3},
    {V4L2_CID_EXPOSURE_ABSOLUTE, V4L2_CTRL_TYPE_INTEGER, "Exposure Time, Absolute", 1, 5000, 156, 156},
    {V4L2_CID_CAMERA_CLASS_BASE + 36, V4L2_CTRL_TYPE_U8, "Region of Interest Rectangle", 0, 0, 0, 0},
};
enum { CONTROLS = sizeof controls / sizeof *controls };
static int64_t since_set;                   /* frames since the exposure was set */
static int64_t taken_ticks[REMEMBERED], taken_gain[REMEMBERED];

__attribute__((constructor)) static void find_real(void)
{
    real_open = dlsym(RTLD_NEXT, "open");
    real_ioctl = dlsym(RTLD_NEXT, "ioctl");
    real_close = dlsym(RTLD_NEXT, "close");
    real_poll = dlsym(RTLD_NEXT, "poll");
    real_munmap = dlsym(RTLD_NEXT, "munmap");
    real_mmap = dlsym(RTLD_NEXT, "mmap");
}

static int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

static void sleep_until(int64_t ns)
{
    struct timespec t = {ns / 1000000000LL, ns % 1000000000LL};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) == EINTR) {}
}

static int every(int number, uint32_t sequence) { return state[number] && sequence % state[number] == state[number] - 1; }

static struct control *control(uint32_t id)
{
    for (int i = 0; i < CONTROLS; i++)
        if (controls[i].id == id) return &controls[i];
    return NULL;
}

static int64_t exposure_ticks(void)
{
    if (control(V4L2_CID_EXPOSURE_AUTO)->value != V4L2_EXPOSURE_MANUAL) return 156;
    return control(V4L2_CID_EXPOSURE_ABSOLUTE)->value + (state[CREEPS] && since_set > state[CREEPS] ? 40 : 0);
}

/* ---- pictures ---- */
static int bits(void) { return format->bits ? format->bits : state[BITS]; }
static unsigned line_bytes(void)
{
    unsigned width = state[WIDTH];
    switch (format->layout) {
    case BYTE: return width + state[LINE_PADDING];
    case MIPI10: case PACKED10: return width * 10 / 8 + state[LINE_PADDING];
    case MIPI12: return width * 12 / 8 + state[LINE_PADDING];
    default: return 2 * width + state[LINE_PADDING];
    }
}
static unsigned image_size(void) { return state[HEIGHT] * line_bytes(); }
static int64_t light_count(void) { return __atomic_load_n(&state[LIGHTS], __ATOMIC_ACQUIRE); }
static int64_t lit_ns(int64_t i) { return state[FIRST_LIGHT + 2 * (i % RING)]; }
static int64_t light_id(int64_t i) { return state[FIRST_LIGHT + 2 * (i % RING) + 1]; }

static int64_t light_at(int64_t ns)
{
    int64_t n = light_count();
    for (int64_t i = n - 1; i >= 0 && i > n - RING; i--)
        if (lit_ns(i) <= ns) return light_id(i);
    return 0;
}

static double bright_part(int64_t start, int64_t end)
{
    int64_t bright = 0, n = light_count(), until = end;
    for (int64_t i = n - 1; i >= 0 && i > n - RING && until > start; i--) {
        int64_t from = lit_ns(i) > start ? lit_ns(i) : start;
        if (from >= until) continue;
        if (light_id(i) & 1) bright += until - from;
        until = from;
    }
    return (double)bright / (end - start);
}

static void write_line(unsigned char *to, const int *v)
{
    int width = state[WIDTH];
    switch (format->layout) {
    case BYTE: for (int x = 0; x < width; x++) to[x] = v[x]; break;
    case YUYV: for (int x = 0; x < width; x++) { to[2 * x] = v[x]; to[2 * x + 1] = 128; } break;
    case LITTLE: for (int x = 0; x < width; x++) { to[2 * x] = v[x]; to[2 * x + 1] = v[x] >> 8; } break;
    case BIG: for (int x = 0; x < width; x++) { to[2 * x] = v[x] >> 8; to[2 * x + 1] = v[x]; } break;
    case MIPI10:
        for (int x = 0; x < width; x += 4, v += 4, to += 5) {
            for (int i = 0; i < 4; i++) to[i] = v[i] >> 2;
            to[4] = (v[0] & 3) | (v[1] & 3) << 2 | (v[2] & 3) << 4 | (v[3] & 3) << 6;
        }
        break;
    case MIPI12:
        for (int x = 0; x < width; x += 2, v += 2, to += 3) {
            to[0] = v[0] >> 4;
            to[1] = v[1] >> 4;
            to[2] = (v[0] & 15) | (v[1] & 15) << 4;
        }
        break;
    case PACKED10:
        for (int x = 0; x < width; x += 4, v += 4, to += 5) {
            to[0] = v[0] >> 2;
            to[1] = (v[0] & 3) << 6 | v[1] >> 4;
            to[2] = (v[1] & 15) << 4 | v[2] >> 6;
            to[3] = (v[2] & 63) << 2 | v[3] >> 8;
            to[4] = v[3];
        }
        break;
    }
}

struct shot { int64_t start, end, ticks, gain; uint32_t sequence; int torn; };

static void paint(unsigned char *to, const struct shot *shot)
{
    int width = state[WIDTH], height = state[HEIGHT], most = (1 << bits()) - 1, line[width];
    int level = most * (0.1 + 0.8 * bright_part(shot->start, shot->end));
    if (state[RESPONDS]) level = shot->ticks < 300 ? most * shot->ticks / 300 : most;
    int64_t ids[2] = {light_at(shot->start), light_at(shot->end)};
    for (int y = 0; y < (shot->torn ? height / 2 : height); y++) {
        int64_t number = -1;
        if (y == 0 || y == height - 1) number = shot->sequence;
        else if (y == height - 2) number = shot->gain;
        else if (y == height - 3) number = shot->ticks;
        else if (4 * y / height < 2) number = ids[4 * y / height];
        for (int x = 0; x < width; x++) {
            char colour = format->colours[2 * (y % 2) + x % 2];
            int value = number < 0 ? level : (number >> (16 * x / width)) & 1 ? most : most / 8;
            line[x] = colour == 'R' ? value / 2 : colour == 'B' ? value / 4 : value;
        }
        write_line(to + y * line_bytes(), line);
        memset(to + (y + 1) * line_bytes() - state[LINE_PADDING], 0xEE, state[LINE_PADDING]);
    }
}

/* ---- the stream ---- */
static void deliver(struct shot *shot)
{
    pthread_mutex_lock(&turn);
    if (streaming && waiting && !state[STALLED] && !state[BROKEN]) {
        unsigned i = queued[0];
        memmove(queued, queued + 1, --waiting * sizeof *queued);
        int64_t stamp = state[STAMP] == END_OF_FRAME ? now_ns() : shot->start;
        if (every(LATE_EVERY, shot->sequence)) stamp += state[LATE_NS];
        if (every(ZERO_EVERY, shot->sequence)) stamp = 0;
        int error = every(ERROR_EVERY, shot->sequence), part = every(SHORT_EVERY, shot->sequence);
        shot->torn = error || part;
        paint(memory[i], shot);
        slots[i].sequence = state[STUCK] ? 0 : shot->sequence;
        slots[i].bytesused = part ? image_size() / 2 : image_size();
        slots[i].timestamp = (struct timeval){stamp / 1000000000LL, stamp % 1000000000LL / 1000};
        slots[i].flags &= ~(V4L2_BUF_FLAG_QUEUED | V4L2_BUF_FLAG_ERROR);
        slots[i].flags |= V4L2_BUF_FLAG_DONE | (error ? V4L2_BUF_FLAG_ERROR : 0);
        filled[done++] = i;
        eventfd_write(owner, 1);
    } else state[DROPPED]++;
    pthread_mutex_unlock(&turn);
}

static void *stream(void *unused)
{
    unsigned seed = state[SEED], held = 0;
    int64_t start = now_ns(), arrived = 0;
    struct shot shots[BURSTS];
    uint32_t sequence = state[FIRST_SEQUENCE];
    for (int64_t frame = 0; streaming; frame++, sequence++) {
        for (; state[PATIENT] && !waiting && streaming && !state[UNPLUGGED]; start = now_ns()) usleep(50);
        taken_ticks[frame % REMEMBERED] = exposure_ticks();
        taken_gain[frame % REMEMBERED] = control(V4L2_CID_GAIN)->value;
        int64_t as_of = (frame > state[CONTROL_LATENCY] ? frame - state[CONTROL_LATENCY] : 0) % REMEMBERED;
        int64_t exposed = taken_ticks[as_of] * (state[LIES] ? 50000LL : 100000LL), end = start + exposed;
        int64_t arrives = end + state[LATENCY_NS] + (int64_t)(rand_r(&seed) / (double)RAND_MAX * state[JITTER_NS]);
        arrived = arrives > arrived ? arrives : arrived;
        sleep_until(arrived);
        int lost = rand_r(&seed) % 1000 < state[DROPPED_PER_1000];
        if (state[UNPLUGGED]) { eventfd_write(owner, 1); break; }
        if (!lost) shots[held++] = (struct shot){start, end, taken_ticks[as_of], taken_gain[as_of], sequence, 0};
        if (state[BURST] < 2 || held >= state[BURST] || held == BURSTS) {
            for (unsigned i = 0; i < held; i++) deliver(&shots[i]);
            held = 0;
        }
        since_set++;
        state[EXPOSED]++;
        int64_t missing = every(JUMP_EVERY, sequence) ? state[JUMP_BY] : 0;
        sequence += missing;
        start += (1 + missing) * (exposed > state[PERIOD_NS] ? exposed : state[PERIOD_NS]);
    }
    return unused;
}

static int no(int error) { errno = error; return -1; }

static void stop_stream(void)
{
    int was = streaming;
    streaming = 0;
    if (was) {
        pthread_mutex_unlock(&turn);
        pthread_join(streamer, NULL);
        pthread_mutex_lock(&turn);
    }
    waiting = done = 0;
    for (unsigned i = 0; i < buffers; i++) slots[i].flags &= ~(V4L2_BUF_FLAG_QUEUED | V4L2_BUF_FLAG_DONE);
    eventfd_t count;
    while (owner >= 0 && !eventfd_read(owner, &count)) {}
    state[BROKEN] = 0;
}

static int start_stream(int fd)
{
    if (fd != owner) return no(owner < 0 ? EINVAL : EBUSY);
    if (streaming) return 0;
    if (state[NO_ROOM]) return no(ENOSPC);
    streaming = 1;
    return pthread_create(&streamer, NULL, stream, NULL) ? no(EIO) : 0;
}

static int known_formats(void)
{
    return state[ALL_FORMATS] ? sizeof formats / sizeof *formats : state[BITS] > 8 ? 3 : 2;
}

static int set_format(struct v4l2_format *f, int set)
{
    if (f->type != V4L2_BUF_TYPE_VIDEO_CAPTURE) return no(EINVAL);
    const struct format *keep = format;
    for (int i = 0; i < known_formats(); i++)
        if (formats[i].fourcc == f->fmt.pix.pixelformat) format = &formats[i];
    f->fmt.pix = (struct v4l2_pix_format){.width = state[WIDTH], .height = state[HEIGHT], .pixelformat = format->fourcc,
        .field = state[INTERLACED] ? V4L2_FIELD_INTERLACED : V4L2_FIELD_NONE, .bytesperline = line_bytes(),
        .sizeimage = image_size(), .colorspace = V4L2_COLORSPACE_RAW};
    if (!set) format = keep;
    return 0;
}

static int request(int fd, struct v4l2_requestbuffers *r)
{
    if (r->type != V4L2_BUF_TYPE_VIDEO_CAPTURE || r->memory != V4L2_MEMORY_MMAP) return no(EINVAL);
    if (state[BUSY] || (owner >= 0 && owner != fd)) return no(EBUSY);
    for (unsigned i = 0; i < BUFFERS; i++)
        if (mapped[i]) return no(EBUSY);
    stop_stream();
    for (unsigned i = 0; i < BUFFERS; i++) { free(memory[i]); memory[i] = NULL; }
    if (r->count) {
        unsigned most = state[BUFFERS_MOST] ? state[BUFFERS_MOST] : BUFFERS;
        if (r->count < state[BUFFERS_LEAST]) r->count = state[BUFFERS_LEAST];
        r->count = r->count < most ? r->count : most;
    }
    buffers = r->count;
    r->capabilities = V4L2_BUF_CAP_SUPPORTS_MMAP;
    owner = buffers ? fd : -1;
    for (unsigned i = 0; i < buffers; i++) {
        uint32_t source = state[STAMP] == END_OF_FRAME ? V4L2_BUF_FLAG_TSTAMP_SRC_EOF : V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
        slots[i] = (struct v4l2_buffer){.index = i, .type = V4L2_BUF_TYPE_VIDEO_CAPTURE, .memory = V4L2_MEMORY_MMAP,
            .length = (image_size() + 4095) / 4096 * 4096, .m.offset = i << COOKIE_BITS, .field = V4L2_FIELD_NONE,
            .flags = state[STAMP] == UNKNOWN_CLOCK ? 0 : V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | source};
        memory[i] = aligned_alloc(4096, slots[i].length);
        memset(memory[i], 0, slots[i].length);
    }
    return 0;
}

static int enqueue(int fd, struct v4l2_buffer *b)
{
    if (fd != owner || b->index >= buffers || b->memory != V4L2_MEMORY_MMAP) return no(EINVAL);
    for (unsigned i = 0; i < waiting; i++)
        if (queued[i] == b->index) return no(EINVAL);
    for (unsigned i = 0; i < done; i++)
        if (filled[i] == b->index) return no(EINVAL);
    slots[b->index].flags |= V4L2_BUF_FLAG_QUEUED;
    queued[waiting++] = b->index;
    *b = slots[b->index];
    return 0;
}

static int dequeue(int fd, struct v4l2_buffer *b)
{
    eventfd_t count;
    if (fd != owner || !streaming) return no(EINVAL);
    if (state[BROKEN]) return no(EIO);
    if (!done) return no(EAGAIN);
    uint32_t turns = dequeued++;
    if (every(EAGAIN_EVERY, turns)) return no(EAGAIN);
    unsigned i = filled[0];
    memmove(filled, filled + 1, --done * sizeof *filled);
    eventfd_read(owner, &count); /* the count is that of a semaphore */
    slots[i].flags &= ~V4L2_BUF_FLAG_DONE;
    if (every(EIO_EVERY, turns)) return no(EIO);
    *b = slots[i];
    return 0;
}

/* ---- controls ---- */
static int describe(struct v4l2_query_ext_ctrl *q)
{
    uint32_t next = q->id & (V4L2_CTRL_FLAG_NEXT_CTRL | V4L2_CTRL_FLAG_NEXT_COMPOUND), id = q->id & ~next;
    for (int i = 0; i < CONTROLS; i++) {
        struct control *c = &controls[i];
        int compound = c->type >= V4L2_CTRL_COMPOUND_TYPES;
        uint32_t kind = compound ? V4L2_CTRL_FLAG_NEXT_COMPOUND : V4L2_CTRL_FLAG_NEXT_CTRL;
        if (next ? c->id <= id || !(next & kind) : c->id != id) continue;
        *q = (struct v4l2_query_ext_ctrl){.id = c->id, .type = c->type, .minimum = c->least, .maximum = c->most,
            .step = 1, .default_value = c->preset, .elem_size = compound ? 16 : 4, .elems = 1};
        if (c->type == V4L2_CTRL_TYPE_CTRL_CLASS) q->flags = V4L2_CTRL_FLAG_READ_ONLY | V4L2_CTRL_FLAG_WRITE_ONLY;
        if (compound) q->flags = V4L2_CTRL_FLAG_HAS_PAYLOAD;
        if (compound && state[NEW_KIND]) q->type = V4L2_CTRL_COMPOUND_TYPES + 7;
        if (c->id == V4L2_CID_EXPOSURE_ABSOLUTE && control(V4L2_CID_EXPOSURE_AUTO)->value != V4L2_EXPOSURE_MANUAL)
            q->flags = V4L2_CTRL_FLAG_INACTIVE;
        snprintf(q->name, sizeof q->name, "%s", c->name);
        return 0;
    }
    return no(EINVAL);
}

static int control_value(uint32_t id, int32_t *value, int set)
{
    struct control *c = control(id);
    if (!c) return no(EINVAL);
    if (c->type == V4L2_CTRL_TYPE_CTRL_CLASS) return no(EACCES);
    if (c->type >= V4L2_CTRL_COMPOUND_TYPES) return no(ENOSPC);
    if (set) {
        int out = *value < c->least || *value > c->most;
        if (out && !state[CLAMPS]) return no(ERANGE);
        if (out) *value = *value < c->least ? c->least : c->most;
        if (id == V4L2_CID_EXPOSURE_AUTO && *value != V4L2_EXPOSURE_MANUAL && *value != V4L2_EXPOSURE_APERTURE_PRIORITY)
            return no(EINVAL);
        if (id == V4L2_CID_EXPOSURE_ABSOLUTE && control(V4L2_CID_EXPOSURE_AUTO)->value != V4L2_EXPOSURE_MANUAL)
            return no(EACCES);
        if (id == V4L2_CID_EXPOSURE_ABSOLUTE && state[CLAMPS]) *value = *value < 10 ? 10 : (*value + 5) / 10 * 10;
        if (id == V4L2_CID_EXPOSURE_ABSOLUTE) since_set = 0;
        if (id == V4L2_CID_BRIGHTNESS) return 0; /* brightness takes everything and keeps nothing */
        c->value = *value;
    }
    if (id == V4L2_CID_EXPOSURE_AUTO && state[AUTO_STAYS]) c->value = V4L2_EXPOSURE_APERTURE_PRIORITY;
    *value = id == V4L2_CID_EXPOSURE_ABSOLUTE ? (int32_t)exposure_ticks() : c->value;
    return 0;
}

static int control_values(struct v4l2_ext_controls *all, int set)
{
    if (all->which && all->which != V4L2_CTRL_CLASS_USER && all->which != V4L2_CTRL_CLASS_CAMERA) return no(EINVAL);
    for (uint32_t i = 0; i < all->count; i++) {
        all->error_idx = i;
        int32_t value = all->controls[i].value;
        if (control_value(all->controls[i].id, &value, set)) return -1;
        all->controls[i].value = value;
    }
    return 0;
}

static int menu(struct v4l2_querymenu *m)
{
    if (m->id != V4L2_CID_EXPOSURE_AUTO || (m->index != 1 && m->index != 3)) return no(EINVAL);
    snprintf((char *)m->name, sizeof m->name, "%s", m->index == 1 ? "Manual Mode" : "Aperture Priority Mode");
    return 0;
}

static int list_format(struct v4l2_fmtdesc *f)
{
    if (f->type != V4L2_BUF_TYPE_VIDEO_CAPTURE || f->index >= (unsigned)known_formats()) return no(EINVAL);
    f->flags = 0;
    f->pixelformat = formats[f->index].fourcc;
    snprintf((char *)f->description, sizeof f->description, "%.4s", (char *)&f->pixelformat);
    return 0;
}

static int list_size(struct v4l2_frmsizeenum *s)
{
    if (s->index > 1) return no(EINVAL);
    s->type = V4L2_FRMSIZE_TYPE_DISCRETE;
    s->discrete = (struct v4l2_frmsize_discrete){state[WIDTH] << s->index, state[HEIGHT] << s->index};
    return 0;
}

static int describe_device(struct v4l2_capability *c)
{
    if (state[QUERY_ERROR]) return no(state[QUERY_ERROR]);
    uint32_t can = state[CAPABILITIES] ? state[CAPABILITIES] : V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_STREAMING;
    *c = (struct v4l2_capability){.driver = "uvcvideo", .card = "Fake Camera", .bus_info = "usb-fake-1",
        .version = 0x60000, .device_caps = can, .capabilities = can | V4L2_CAP_VIDEO_CAPTURE | V4L2_CAP_DEVICE_CAPS};
    return 0;
}

static int answer(int fd, unsigned long number, void *arg)
{
    struct v4l2_buffer *b = arg;
    struct v4l2_streamparm *p = arg;
    struct v4l2_control *c = arg;
    if (state[UNPLUGGED]) return no(ENODEV);
    switch (number) {
    case VIDIOC_QUERYCAP: return describe_device(arg);
    case VIDIOC_ENUMINPUT:
        if (((struct v4l2_input *)arg)->index) return no(EINVAL);
        *(struct v4l2_input *)arg = (struct v4l2_input){.name = "Camera 1", .type = V4L2_INPUT_TYPE_CAMERA};
        return 0;
    case VIDIOC_G_INPUT: case VIDIOC_S_INPUT: *(int *)arg = 0; return 0;
    case VIDIOC_ENUM_FMT: return list_format(arg);
    case VIDIOC_ENUM_FRAMESIZES: return list_size(arg);
    case VIDIOC_G_FMT: ((struct v4l2_format *)arg)->fmt.pix.pixelformat = format->fourcc; return set_format(arg, 0);
    case VIDIOC_TRY_FMT: return set_format(arg, 0);
    case VIDIOC_S_FMT: return state[BUSY] || buffers ? no(EBUSY) : set_format(arg, 1);
    case VIDIOC_S_PARM: if (streaming) return no(EBUSY); /* fall through */
    case VIDIOC_G_PARM:
        if (p->type != V4L2_BUF_TYPE_VIDEO_CAPTURE) return no(EINVAL);
        p->parm.capture = (struct v4l2_captureparm){.capability = V4L2_CAP_TIMEPERFRAME,
            .timeperframe = {state[PERIOD_NS] / 1000, 1000000}};
        return 0;
    case VIDIOC_REQBUFS: return request(fd, arg);
    case VIDIOC_QUERYBUF: if (b->index >= buffers) return no(EINVAL); *b = slots[b->index]; return 0;
    case VIDIOC_QBUF: return enqueue(fd, b);
    case VIDIOC_DQBUF: return dequeue(fd, b);
    case VIDIOC_STREAMON: return start_stream(fd);
    case VIDIOC_STREAMOFF: if (fd == owner) stop_stream(); return 0;
    case VIDIOC_QUERY_EXT_CTRL: return describe(arg);
    case VIDIOC_QUERYMENU: return menu(arg);
    case VIDIOC_G_CTRL: case VIDIOC_S_CTRL: return control_value(c->id, &c->value, number == VIDIOC_S_CTRL);
    case VIDIOC_G_EXT_CTRLS: case VIDIOC_S_EXT_CTRLS: return control_values(arg, number == VIDIOC_S_EXT_CTRLS);
    }
    return no(ENOTTY);
}

/* ---- in the place of the C library ---- */
static int is_ours(int fd) { return fd >= 0 && fd < FDS && ours[fd]; }

static int open_ours(const char *path, int flags, mode_t mode)
{
    const char *node = getenv("FAKE_V4L2");
    if (!node || strcmp(path, node) || access(node, F_OK)) return real_open(path, flags, mode);
    if (!state) {
        char name[4096];
        snprintf(name, sizeof name, "%s.state", node);
        int fd = real_open(name, O_RDWR);
        if (fd < 0) return -1;
        state = real_mmap(NULL, STATE_LENGTH * sizeof *state, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
        real_close(fd);
    }
    if (state[FORBIDDEN]) return no(EACCES);
    if (state[OPEN_ERROR]) return no(state[OPEN_ERROR]);
    int fd = eventfd(0, EFD_NONBLOCK | EFD_SEMAPHORE | EFD_CLOEXEC);
    if (fd >= 0 && fd < FDS) ours[fd] = 1;
    return fd;
}

#define OPEN(name)                                                                     \
    int name(const char *path, int flags, ...)                                         \
    {                                                                                  \
        va_list rest;                                                                  \
        va_start(rest, flags);                                                         \
        mode_t mode = flags & (O_CREAT | __O_TMPFILE) ? va_arg(rest, mode_t) : 0;      \
        va_end(rest);                                                                  \
        return open_ours(path, flags, mode);                                           \
    }
OPEN(open)
OPEN(open64)

int ioctl(int fd, unsigned long number, ...)
{
    va_list rest;
    va_start(rest, number);
    void *arg = va_arg(rest, void *);
    va_end(rest);
    if (!is_ours(fd)) return real_ioctl(fd, number, arg);
    pthread_mutex_lock(&turn);
    int result = answer(fd, number & 0xffffffff, arg);
    pthread_mutex_unlock(&turn);
    return result;
}

static short trouble(int fd)
{
    if (state[UNPLUGGED]) return POLLERR | POLLHUP;
    int empty = !waiting && !done; /* nothing is queued, nothing will come */
    return fd != owner || !streaming || state[BROKEN] || empty ? POLLERR : 0;
}

int poll(struct pollfd *asked, nfds_t count, int timeout)
{
    int64_t deadline = now_ns() + timeout * 1000000LL;
    for (;;) {
        int troubled = 0, device = 0;
        for (nfds_t i = 0; i < count; i++) {
            if (!is_ours(asked[i].fd)) continue;
            device = 1;
            troubled |= trouble(asked[i].fd);
        }
        int64_t left = (deadline - now_ns() + 999999) / 1000000;
        int wait = troubled ? 0 : timeout < 0 || left > 20 ? 20 : left > 0 ? left : 0;
        int ready = real_poll(asked, count, device ? wait : timeout);
        if (!device || ready < 0) return ready;
        for (nfds_t i = 0; i < count; i++) {
            if (!is_ours(asked[i].fd)) continue;
            short found = trouble(asked[i].fd);
            if (found && !asked[i].revents) ready++;
            if (found) asked[i].revents = found;
        }
        if (ready || (timeout >= 0 && now_ns() >= deadline)) return ready;
    }
}
int __poll_chk(struct pollfd *asked, nfds_t count, int timeout, size_t size) { (void)size; return poll(asked, count, timeout); }

void *mmap(void *at, size_t length, int protection, int flags, int fd, off_t offset)
{
    if (!is_ours(fd)) return real_mmap(at, length, protection, flags, fd, offset);
    unsigned i = offset >> COOKIE_BITS;
    if (state[UNPLUGGED]) { errno = ENODEV; return MAP_FAILED; }
    if (i >= buffers || length > slots[i].length || !(flags & MAP_SHARED)) { errno = EINVAL; return MAP_FAILED; }
    if (!mapped[i]) state[MAPPED]++;
    mapped[i] = 1;
    return memory[i];
}
void *mmap64(void *at, size_t length, int protection, int flags, int fd, off_t offset)
{
    return mmap(at, length, protection, flags, fd, offset);
}

int munmap(void *at, size_t length)
{
    for (unsigned i = 0; i < BUFFERS; i++)
        if (at && at == memory[i]) {
            if (mapped[i]) state[MAPPED]--;
            mapped[i] = 0;
            return 0;
        }
    if (!real_munmap) real_munmap = dlsym(RTLD_NEXT, "munmap");
    return real_munmap(at, length);
}

int close(int fd)
{
    if (is_ours(fd)) {
        pthread_mutex_lock(&turn);
        ours[fd] = 0;
        if (fd == owner) { stop_stream(); owner = -1; buffers = 0; }
        pthread_mutex_unlock(&turn);
    }
    return real_close(fd);
}
