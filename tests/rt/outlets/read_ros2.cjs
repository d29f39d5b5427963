// SPDX-License-Identifier: Apache-2.0
// What ROS 2 makes of the bytes that holdfast-fastdds-peer heard: decodes each line "TOPIC HEX" of FILE
// with the message definitions that ROS 2 itself ships (Humble and Jazzy), encodes what came out
// again, and compares byte for byte:
//   node read_ros2.cjs FILE
// prints a JSON object, topic -> list of messages. Ends with 1 where anything differs.
const assert = require("node:assert");
const fs = require("node:fs");
const { ros2humble, ros2jazzy } = require("@foxglove/rosmsg-msgs-common");
const { MessageReader, MessageWriter } = require("@foxglove/rosmsg2-serialization");

const TYPES = {
  "rt/tf": "tf2_msgs/TFMessage",
  "rt/tf_static": "tf2_msgs/TFMessage",
  "rt/holdfast/target_pose": "geometry_msgs/PoseWithCovarianceStamped",
  "rt/diagnostics": "diagnostic_msgs/DiagnosticArray",
  "rt/holdfast/image": "sensor_msgs/Image",
};

function definitions(all, root) {  // of the type and of what it is made of, the root first
  const known = new Set();
  const take = (name) => {
    if (known.has(name)) return;
    known.add(name);
    for (const field of all[name].definitions) if (field.isComplex) take(field.type);
  };
  take(root);
  return [...known].map((name) => (name === root ? { definitions: all[name].definitions } : all[name]));
}

function decode(all, topic, bytes) {
  const types = definitions(all, TYPES[topic]);
  const message = new MessageReader(types).readMessage(bytes);
  const again = Buffer.from(new MessageWriter(types).writeMessage(message));
  // A payload may end in up to three bytes of padding.
  assert(bytes.length - again.length < 4, `${topic}: ${bytes.length} bytes, ROS writes ${again.length}`);
  assert(bytes.subarray(0, again.length).equals(again), `${topic}: bytes differ`);
  assert(bytes.subarray(again.length).every((byte) => byte === 0), `${topic}: padding`);
  return message;
}

const out = {};
for (const line of fs.readFileSync(process.argv[2], "utf8").split("\n")) {
  const [topic, hex] = line.split(" ");
  if (!(topic in TYPES) || !hex) continue;
  const bytes = Buffer.from(hex, "hex");
  const message = decode(ros2humble, topic, bytes);
  assert.deepStrictEqual(decode(ros2jazzy, topic, bytes), message);
  (out[topic] ??= []).push(message);
}
const plain = (_key, value) => (ArrayBuffer.isView(value) ? Array.from(value) : value);
console.log(JSON.stringify(out, plain));
