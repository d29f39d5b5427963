// SPDX-License-Identifier: Apache-2.0
// Reads a recording as Foxglove does and prints what is in it as one JSON object:
//   node read.cjs FILE [CYCLE]
// topics: how many messages the streaming reader finds on each; indexed: the same by the index at
// the end, null where the file has none; input, decision, session, log: decoded, of that cycle or
// the newest. Numbers of 64 bits and floats come as text, lossless.
const fs = require("node:fs");
const { McapIndexedReader, McapStreamReader } = require("@mcap/core");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");

const text = (_key, value) => {
  if (typeof value === "bigint") return value.toString();
  if (typeof value === "number" && !Number.isInteger(value)) return String(value);
  if (ArrayBuffer.isView(value)) return Array.from(value, String);
  return value;
};

function stream(bytes, onMessage) {
  const reader = new McapStreamReader();  // checks every CRC; a file cut off simply ends early
  const schemas = new Map();
  const channels = new Map();
  reader.append(bytes);
  for (let record; (record = reader.nextRecord());) {
    if (record.type === "Schema") schemas.set(record.id, record);
    if (record.type === "Channel") channels.set(record.id, { ...record, schema: schemas.get(record.schemaId) });
    if (record.type === "Message") onMessage(channels.get(record.channelId), record.data);
  }
  return reader.done();
}

async function indexed(file) {
  const handle = await fs.promises.open(file);
  const readable = {
    size: async () => BigInt((await handle.stat()).size),
    read: async (offset, length) => {
      const buffer = new Uint8Array(Number(length));
      await handle.read(buffer, 0, buffer.length, Number(offset));
      return buffer;
    },
  };
  const counts = {};
  const reader = await McapIndexedReader.Initialize({ readable });
  for await (const message of reader.readMessages()) {
    const topic = reader.channelsById.get(message.channelId).topic;
    counts[topic] = (counts[topic] ?? 0) + 1;
  }
  await handle.close();
  const statistics = Object.fromEntries(
    [...reader.statistics.channelMessageCounts].map(([id, n]) => [reader.channelsById.get(id).topic, Number(n)]));
  return { counts, statistics, chunks: reader.chunkIndexes.length };
}

async function main() {
  const [file, cycle] = process.argv.slice(2);
  const out = { topics: {}, encodings: {}, indexed: null };
  const readers = new Map();
  const isClosed = stream(fs.readFileSync(file), (channel, data) => {
    const { topic, schema } = channel;
    out.topics[topic] = (out.topics[topic] ?? 0) + 1;
    out.encodings[topic] = `${channel.messageEncoding} ${schema.encoding} ${schema.name}`;
    if (!readers.has(topic)) {
      const definition = parse(new TextDecoder().decode(schema.data), { ros2: true });
      readers.set(topic, new MessageReader(definition));
    }
    const message = readers.get(topic).readMessage(data);  // every message decodes
    if (cycle === undefined || message.cycle === undefined || message.cycle === BigInt(cycle))
      out[topic.split("/").pop()] = message;
  });
  if (isClosed) out.indexed = await indexed(file);
  console.log(JSON.stringify(out, text));
}

main().catch((error) => {
  console.error(`${error.message}`);
  process.exit(1);
});
