"""Track people live from boxes on an MQTT broker.

    pip install paho-mqtt
    python examples/watch_mqtt.py scene.json --host localhost

Cameras publish lines to `boxes/NAME`, in the format of `catfree watch`; positions go to
`people/final`, `people/provisional` and so on. An empty message to `boxes/end` ends the program.
"""

import argparse
import json
import queue

import paho.mqtt.client as mqtt

import catfree as cf


def main() -> None:
    """Connect a broker to a tracker."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", help="cameras and ground, as cf.read_scene reads them")
    parser.add_argument("--host", default="localhost", help="of the broker")
    parser.add_argument("--port", type=int, default=1883, help="of the broker")
    parser.add_argument("--frame-rate", type=float, default=5.0, help="instants per second")
    options = parser.parse_args()
    scene, names = cf.read_scene(options.scene)

    lines: queue.Queue[str] = queue.Queue()
    client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    client.on_connect = lambda *_: client.subscribe("boxes/#", qos=1)
    client.on_message = lambda _client, _data, message: lines.put(message.payload.decode())
    client.connect(options.host, options.port)
    client.loop_start()
    rate = options.frame_rate
    tracker = cf.Tracker(scene, lag=2.0)
    # An empty message ends the stream; an instant waits half a second for late cameras.
    for record in cf.watch(iter(lines.get, ""), tracker, names, frame_rate=rate, timeout=0.5):
        client.publish(f"people/{record['type']}", json.dumps(record), qos=1).wait_for_publish()
    client.loop_stop()


if __name__ == "__main__":
    main()
