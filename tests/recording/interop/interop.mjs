// Passes recordings both ways between this project's library and @mcap/core and compares every message.
//   node interop.mjs RECORDING_FIXTURE WORK_DIR
// Exit status 77 (skipped) when the packages are not installed: npm ci --ignore-scripts

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const [fixture, workDir] = process.argv.slice(2);

let core, support, zstd;
try {
  core = await import("@mcap/core");
  support = await import("@mcap/support");
  const require = createRequire(import.meta.url);
  zstd = require("@foxglove/wasm-zstd");
} catch (error) {
  if (!/Cannot find (package|module)/.test(String(error))) throw error;
  console.log(`skipped: run "npm ci --ignore-scripts" in ${dirname(fileURLToPath(import.meta.url))} first`);
  process.exit(77);
}
await zstd.isLoaded;
const decompressHandlers = await support.loadDecompressHandlers();

rmSync(workDir, { recursive: true, force: true });
mkdirSync(workDir, { recursive: true });

function run(...args) {
  return JSON.parse(execFileSync(fixture, args, { encoding: "utf8", maxBuffer: 1 << 28 }));
}

function shown(message, channels, schemas) {
  const channel = channels.get(message.channelId);
  const schema = schemas.get(channel.schemaId);
  return {
    topic: channel.topic,
    schema: schema.name,
    encoding: channel.messageEncoding,
    log_time: String(message.logTime),
    publish_time: String(message.publishTime),
    sequence: message.sequence,
    data: Buffer.from(message.data).toString("hex"),
  };
}

function readFrontToBack(bytes) {
  const reader = new core.McapStreamReader({ decompressHandlers, validateCrcs: true });
  reader.append(bytes);
  const channels = new Map();
  const schemas = new Map();
  const messages = [];
  const records = {};
  for (let record; (record = reader.nextRecord()); ) {
    records[record.type] = record;
    if (record.type === "Schema") schemas.set(record.id, record);
    if (record.type === "Channel") channels.set(record.id, record);
    if (record.type === "Message") messages.push(shown(record, channels, schemas));
  }
  assert.ok(reader.done(), "the file has its footer and magic");
  return { messages, schemas, records };
}

// CRC-32 bit by bit, from its polynomial.
function crc32(bytes) {
  let crc = 0xffffffff;
  for (const byte of bytes) {
    crc ^= byte;
    for (let bit = 0; bit < 8; bit++) crc = (crc >>> 1) ^ (crc & 1 ? 0xedb88320 : 0);
  }
  return (crc ^ 0xffffffff) >>> 0;
}

async function readByIndex(bytes) {
  const readable = {
    size: async () => BigInt(bytes.byteLength),
    read: async (offset, size) => bytes.subarray(Number(offset), Number(offset + size)),
  };
  const reader = await core.McapIndexedReader.Initialize({ readable, decompressHandlers });
  const messages = [];
  for await (const message of reader.readMessages()) {
    messages.push(shown(message, reader.channelsById, reader.schemasById));
  }
  return { reader, messages };
}

let files = 0;
for (const compression of ["none", "lz4", "zstd"]) {
  for (const chunking of ["chunked", "plain"]) {
    for (const summary of ["summary", "bare"]) {
      const path = join(workDir, `ours-${compression}-${chunking}-${summary}.mcap`);
      const written = run("write", path, compression, chunking, summary);
      assert.equal(written.length, 300);
      const bytes = new Uint8Array(readFileSync(path));
      const { messages, schemas, records } = readFrontToBack(bytes);
      assert.deepEqual(messages, written, path);

      // Behind the data: DataEnd (13 bytes), the summary, the footer (29 bytes, its CRC last), the magic (8 bytes).
      const footer = records.Footer;
      const behindData = Number(footer.summaryStart) || bytes.length - 8 - 29;
      assert.equal(footer.summaryStart > 0n, summary === "summary");
      assert.equal(records.DataEnd.dataSectionCrc, crc32(bytes.subarray(0, behindData - 13)), path);
      assert.equal(footer.summaryCrc, crc32(bytes.subarray(behindData, bytes.length - 12)), path);

      for (const schema of schemas.values()) {
        assert.equal(schema.encoding, "protobuf");
        const root = support.protobufFromBinaryDescriptor(schema.data);
        const type = root.lookupType(schema.name);
        const sample = written.find((message) => message.schema === schema.name);
        const decoded = type.toObject(type.decode(Buffer.from(sample.data, "hex")));
        assert.equal(Number(decoded.timestamp.seconds), Number(BigInt(sample.log_time) / 1000000000n));
      }
      if (chunking === "chunked" && summary === "summary") {
        const { reader, messages } = await readByIndex(bytes);
        assert.deepEqual(messages, written, path);
        assert.ok(reader.chunkIndexes.length > 1);
        assert.equal(reader.statistics.messageCount, 300n);
        assert.equal(reader.statistics.chunkCount, reader.chunkIndexes.length);
        assert.equal(reader.statistics.channelCount, 2);
        const counts = [...reader.channelsById.values()].map((channel) => [
          channel.topic,
          reader.statistics.channelMessageCounts.get(channel.id),
        ]);
        assert.deepEqual(new Map(counts), new Map([["/audio", 100n], ["/scan", 200n]]));
        assert.equal(String(reader.statistics.messageStartTime), written[0].log_time);
        assert.equal(String(reader.statistics.messageEndTime), written[299].log_time);
      }
      files++;
    }
  }
}

class Memory {
  #parts = [];
  #size = 0n;
  async write(bytes) {
    this.#parts.push(new Uint8Array(bytes));
    this.#size += BigInt(bytes.byteLength);
  }
  position() {
    return this.#size;
  }
  bytes() {
    return Buffer.concat(this.#parts);
  }
}

const compressors = {
  none: undefined,
  zstd: (data) => ({ compression: "zstd", compressedData: zstd.compress(data) }),
};
for (const [compression, compressChunk] of Object.entries(compressors)) {
  for (const useChunks of [true, false]) {
    for (const full of [true, false]) {
      const memory = new Memory();
      const writer = new core.McapWriter({
        writable: memory,
        useChunks,
        useStatistics: full,
        useSummaryOffsets: full,
        repeatSchemas: full,
        repeatChannels: full,
        useAttachmentIndex: full,
        useMetadataIndex: full,
        useMessageIndex: full,
        useChunkIndex: full,
        chunkSize: 10_000,
        compressChunk: useChunks ? compressChunk : undefined,
      });
      await writer.start();
      const schemaId = await writer.registerSchema({ name: "foxglove.RawAudio", encoding: "protobuf", data: new Uint8Array([1, 2, 3]) });
      const written = [];
      const channelIds = [];
      for (const topic of ["/audio", "/zweites/öhr"]) {
        channelIds.push(await writer.registerChannel({ topic, schemaId, messageEncoding: "protobuf", metadata: new Map([["key", "value"]]) }));
      }
      await writer.addMetadata({ name: "about", metadata: new Map([["who", "test"]]) });
      for (let i = 0; i < 400; i++) {
        const data = Uint8Array.from({ length: (i * 7) % 300 }, (_, k) => (i * k) & 255);
        const logTime = 1_700_000_000_000_000_000n + BigInt((i * 7919) % 1000);
        await writer.addMessage({ channelId: channelIds[i % 2], sequence: i, logTime, publishTime: logTime + 5n, data });
        written.push({
          topic: ["/audio", "/zweites/öhr"][i % 2],
          schema: "foxglove.RawAudio",
          encoding: "protobuf",
          log_time: String(logTime),
          publish_time: String(logTime + 5n),
          sequence: i,
          data: Buffer.from(data).toString("hex"),
        });
        if (i === 200) {
          await writer.addAttachment({ name: "a", mediaType: "text/plain", logTime: 1n, createTime: 2n, data: new Uint8Array(100_000).fill(65) });
        }
      }
      await writer.end();
      const path = join(workDir, `theirs-${compression}-${useChunks}-${full}.mcap`);
      writeFileSync(path, memory.bytes());
      assert.deepEqual(run("show", path), written, path);
      files++;
    }
  }
}
console.log(`${files} files agree`);
