#!/usr/bin/python3
"""Stands in for FFmpeg where films go wrong: RIPNERF_FAKE_FFMPEG says how.

`tall` shows frames that are much higher than wide, `flat` of no height; `many` shows small ones, a
million and more, `endless` never ends; `noise` writes what is no picture, for ever, `silent` nothing;
`absurd` tells a duration that no film has; `cut` ends within a frame; `none` has no frame; `gone` shows
frames and then takes none of them; `crash` is killed within the film; `other`
finds that it is none.
"""

import os
import signal
import sys
import time

mood = os.environ["RIPNERF_FAKE_FFMPEG"]
words = sys.argv[1:]
out = sys.stdout.buffer


def frame(width=48, height=36, shade=0):
    return b"P5\n%d %d\n255\n" % (width, height) + bytes((shade + 7 * i) % 256 for i in range(width * height))


def write(content, times=1):
    for _ in range(times):
        out.write(content)
    out.flush()


print(f"  Duration: {'999999999:-1:1e300' if mood == 'absurd' else '00:00:02.00'}, start: 0", file=sys.stderr)
if words[-1] != "-":  # the chosen frames
    assert words[words.index("-format_whitelist") + 1] == "mov,matroska,avi,mpegts"
    if mood in ("absurd", "cut"):
        from PIL import Image
        for i in range(4):
            Image.new("RGB", (48, 36), (40 * i, 90, 90)).save(words[-1] % (i + 1))
elif mood == "tall":
    write(frame(480, 8000))
elif mood == "flat":
    write(b"P5\n480 0\n255\n")
elif mood == "many":
    write(frame(3, 3) * 1000, 1001)
elif mood in ("endless", "noise"):
    while True:
        write(frame() if mood == "endless" else b"no picture at all" * 4096)
elif mood == "silent":
    time.sleep(3600)
elif mood == "other":
    sys.exit("walk.mp4: Invalid argument")
elif mood != "none":
    write(b"".join(frame(shade=i) for i in range(40)))
    if mood == "cut":
        write(frame()[:-100])
    if mood == "crash":
        os.kill(os.getpid(), signal.SIGKILL)
