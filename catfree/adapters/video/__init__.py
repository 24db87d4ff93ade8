"""Synchronized videos, and detections from them."""

from catfree.adapters.video._common_clock import on_common_clock as on_common_clock
from catfree.adapters.video._detect_videos import (
    detect_videos as detect_videos,
)
from catfree.adapters.video._synchronized_videos import (
    SynchronizedVideos as SynchronizedVideos,
)
