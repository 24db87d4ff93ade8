"""Boxes come from a broker and from a folder of segments; positions go out meanwhile."""

import json
import shutil
import socket
import subprocess
import sys
import threading
import time

import cv2
import numpy as np
import pytest

from catfree.adapters import write_scene_json
from catfree.synthetic import make_world

pytestmark = pytest.mark.slow

RATE = 5


def free_port():
    """Find an unused port of this machine."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def broker(tmp_path):
    """Return the port of a running mosquitto."""
    program = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
    if program is None:
        pytest.skip("needs the broker mosquitto (Debian: apt-get install mosquitto)")
    port = free_port()
    (tmp_path / "broker.conf").write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
    process = subprocess.Popen(
        [program, "-c", str(tmp_path / "broker.conf")], stderr=subprocess.DEVNULL
    )
    for _ in range(100):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                break
        time.sleep(0.05)
    yield port
    process.terminate()
    process.wait()


def near(people, world, frame):
    """Compute the share of an instant's people within half a meter of a true position."""
    truth = world.ground_truth[world.ground_truth[:, 0] == frame][:, 2:4]
    found = np.array([(person["x"], person["y"]) for person in people])
    return np.mean([np.linalg.norm(found - at, axis=1).min() < 0.5 for at in truth])


def test_positions_come_back_through_the_broker(load_example, broker, tmp_path, monkeypatch):
    mqtt = pytest.importorskip("paho.mqtt.client")
    world = make_world("ring4", frames=30, people=4)
    scene = tmp_path / "scene.json"
    names = [f"c{camera}" for camera in range(world.scene.rig.camera_count)]
    write_scene_json(scene, world.true_scene, names)
    arguments = ["watch_mqtt.py", str(scene), "--port", str(broker), "--frame-rate", str(RATE)]
    monkeypatch.setattr(sys, "argv", arguments)
    program = threading.Thread(target=load_example("watch_mqtt").main)

    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    received, subscribed, listening = [], threading.Event(), threading.Event()
    client.on_subscribe = lambda *_: subscribed.set()

    def receive(_client, _data, message):
        if message.topic == "$SYS/broker/subscriptions/count":
            return
        if message.topic == "people/error":
            listening.set()
        received.append((message.topic, json.loads(message.payload)))

    client.on_message = receive
    client.connect("127.0.0.1", broker)
    client.subscribe("people/#", qos=1)
    client.loop_start()
    assert subscribed.wait(10)
    program.start()
    while not listening.wait(0.1):  # until the program has subscribed, and answers
        client.publish("boxes/hello", "hello", qos=1)
        assert program.is_alive()
    seen = world.detections
    for frame in range(30):
        for camera, name in enumerate(names):
            boxes = seen.box[(seen.frame == frame) & (seen.camera == camera)].tolist()
            line = {"camera": name, "time": frame / RATE, "boxes": boxes}
            client.publish(f"boxes/{name}", json.dumps(line), qos=1).wait_for_publish(10)
    client.publish("boxes/end", "", qos=1)
    program.join(120)
    assert not program.is_alive()
    time.sleep(0.5)  # the last messages
    client.loop_stop()
    final = {
        round(record["time"] * RATE): record["people"]
        for topic, record in received
        if topic == "people/final"
    }
    late = [near(final[frame], world, frame) for frame in range(10, 30) if final.get(frame)]
    assert len(late) > 15
    assert np.mean(late) > 0.9
    assert any(topic == "people/provisional" for topic, _ in received)


def test_segments_are_followed_while_cameras_write_them(
    load_example, rendered, tmp_path, monkeypatch, capsys
):
    videos, world = rendered
    names = [f"c{camera}" for camera in range(3)]
    write_scene_json(tmp_path / "scene.json", world.true_scene, names)
    live = tmp_path / "live"
    for name, video in zip(names, videos, strict=True):
        (live / name).mkdir(parents=True)
        reader = cv2.VideoCapture(video)
        pictures = [reader.read()[1] for _ in range(60)]
        for part in range(3):
            height, width = pictures[0].shape[:2]
            writer = cv2.VideoWriter(
                str(live / name / f"{part:06d}.mp4"),
                cv2.VideoWriter.fourcc(*"mp4v"),
                RATE,
                (width, height),
            )
            for picture in pictures[20 * part : 20 * part + 20]:
                writer.write(picture)
            writer.release()
    arguments = ["watch_segments.py", str(live), str(tmp_path / "scene.json")]
    monkeypatch.setattr(sys, "argv", arguments)
    ending = threading.Timer(1.0, (live / "end").touch)
    ending.start()
    load_example("watch_segments").main()
    ending.join()
    records = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    final = [record for record in records if record["type"] == "final"]
    times = [record["time"] for record in final]
    assert times == sorted(times)
    assert len(final) > 40
    shares = [near(r["people"], world, round(r["time"] * RATE)) for r in final[10:]]
    assert np.mean(shares) > 0.5
