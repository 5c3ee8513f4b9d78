// Reads every message of an MCAP twice, by its index and as a stream, decodes each, and prints what it found as JSON.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";

const require = createRequire(process.cwd() + "/");
const { McapIndexedReader, McapStreamReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");

const bytes = readFileSync(process.argv[2]);
const decompressHandlers = await loadDecompressHandlers();
const plain = (key, value) => (typeof value === "bigint" ? Number(value) : ArrayBuffer.isView(value) ? Array.from(value) : value);

const readable = {
  size: async () => BigInt(bytes.length),
  read: async (offset, size) => new Uint8Array(bytes.buffer, bytes.byteOffset + Number(offset), Number(size)),
};
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
const decoders = new Map(), topics = {};
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const channel = reader.channelsById.get(message.channelId), schema = reader.schemasById.get(channel.schemaId);
  if (!decoders.has(schema.id)) {
    const definition = parse(new TextDecoder().decode(schema.data), { ros2: true });
    decoders.set(schema.id, new MessageReader(definition));
  }
  const value = decoders.get(schema.id).readMessage(message.data);
  const found = (topics[channel.topic] ??= { type: schema.name, count: 0, times: [], values: [] });
  found.count += 1;
  if (channel.topic.startsWith("/bodylog/")) {
    found.times.push(message.logTime.toString());
    found.values.push(value);
  }
}

const stream = new McapStreamReader({ decompressHandlers, validateCrcs: true });
stream.append(bytes);
let streamed = 0, metadata = [];
for (let record; (record = stream.nextRecord()); ) {
  if (record.type === "Message") streamed += 1;
  if (record.type === "Metadata") metadata.push(record.name);
}
const declared = Number(reader.statistics.messageCount);
console.log(JSON.stringify({ topics, streamed, declared, done: stream.done(), metadata }, plain));
