// The npm package `canopen` as a master; frames are lines on standard input and output: 620#4000100000000000.
const readline = require("node:readline");
const { createRequire } = require("node:module");
const { Device, DataType, NmtState } = createRequire(process.env.CANFB_NODE_CANOPEN + "/")("canopen");

const NODE = 0x20;
const device = new Device({ id: 0x7e });
device.addListener("message", ({ id, data }) => {
  const text = Buffer.from(data || []).toString("hex");
  process.stdout.write(id.toString(16).padStart(3, "0") + "#" + text + "\n");
});
readline.createInterface({ input: process.stdin }).on("line", (line) => {
  const [id, data] = line.split("#");
  const buffer = Buffer.from(data, "hex");
  device.receive({ id: parseInt(id, 16), data: buffer, len: buffer.length });
});

async function main() {
  device.eds.addSdoClientParameter(NODE, 0x600 + NODE, 0x580 + NODE);
  device.start();
  device.nmt.startNode(device.id); // its own NMT state decides which services it has
  const sdo = device.protocol.sdoClient;
  const to = { deviceId: NODE, timeout: 5000 };
  const result = {};
  result.deviceType = await sdo.upload({ ...to, index: 0x1000, dataType: DataType.UNSIGNED32 });
  result.name = await sdo.upload({ ...to, index: 0x1008, dataType: DataType.VISIBLE_STRING });
  result.abort = await sdo.upload({ ...to, index: 0x1004 }).catch((error) => error.code);
  const eds = await sdo.upload({ ...to, index: 0x1021, blockTransfer: true });
  result.eds = eds.toString("latin1");
  await sdo.download({ ...to, index: 0x1017, data: 100, dataType: DataType.UNSIGNED16 });
  const table = Buffer.alloc(512);
  for (let n = 0; n < 128; n++) table.writeFloatLE(n / 128, 4 * n);
  for (const blockTransfer of [false, true]) {
    await sdo.download({ ...to, index: 0x2020, subIndex: 1, data: table, blockTransfer });
    const crc = await sdo.upload({ ...to, index: 0x2020, subIndex: 2, dataType: DataType.UNSIGNED32 });
    result[blockTransfer ? "blockCrc" : "segmentedCrc"] = crc;
  }
  process.stdout.write("RESULT " + JSON.stringify(result) + "\n");
  process.exit(0);
}

main().catch((error) => {
  process.stdout.write("RESULT " + JSON.stringify({ error: String(error) }) + "\n");
  process.exit(1);
});
