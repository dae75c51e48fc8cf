// How does a zip open and close in the browser? A folder is dropped as files, and a model's go to the server as one zip;
// a zip is dropped whole, and what is in it beside the model are scans. (APPNOTE.TXT 6.3: 4.3.7, 4.3.12, 4.3.16)

const ENTRY = 0x02014b50;
const LOCAL = 0x04034b50;
const END = 0x06054b50;
const END_SIZE = 22;
const LONGEST_COMMENT = 65535;
const FLAG_UTF8 = 1 << 11;
const DEFLATED = 8;
// What is unpacked here at most: the server unpacks a model's zip up to as much.
const MOST_BYTES = 500 * 2 ** 20;

// The files in a zip, as { path, file() } of which `file` unpacks one. Throws a sentence where it is none.
export async function entriesOf(zip) {
  const tail = await viewOf(zip.slice(Math.max(0, zip.size - END_SIZE - LONGEST_COMMENT)));
  let at = tail.byteLength - END_SIZE;
  while (at >= 0 && tail.getUint32(at, true) !== END) at -= 1;
  if (at < 0) throw new Error(`'${zip.name}' is not a zip file, or its end is missing.`);
  const start = tail.getUint32(at + 16, true);
  const list = await viewOf(zip.slice(start, start + tail.getUint32(at + 12, true)));
  const found = [];
  let total = 0;
  for (let place = 0; place + 46 <= list.byteLength && list.getUint32(place, true) === ENTRY; ) {
    const [method, packed, size] = [10, 20, 24].map((offset, n) =>
      n ? list.getUint32(place + offset, true) : list.getUint16(place + offset, true),
    );
    const [name, extra, comment] = [28, 30, 32].map((offset) => list.getUint16(place + offset, true));
    const local = list.getUint32(place + 42, true);
    const path = new TextDecoder().decode(new Uint8Array(list.buffer, list.byteOffset + place + 46, name));
    total += size;
    if (!path.endsWith("/")) found.push({ path, file: () => unpacked(zip, path, { method, packed, size, local }) });
    place += 46 + name + extra + comment;
  }
  if (total > MOST_BYTES) throw new Error(`'${zip.name}' unpacks to more than ${MOST_BYTES / 2 ** 20} MiB.`);
  return found;
}

async function unpacked(zip, path, { method, packed, size, local }) {
  const head = await viewOf(zip.slice(local, local + 30));
  if (head.byteLength < 30 || head.getUint32(0, true) !== LOCAL)
    throw new Error(`'${path}' in '${zip.name}' is damaged.`);
  const begin = local + 30 + head.getUint16(26, true) + head.getUint16(28, true);
  const body = zip.slice(begin, begin + packed);
  if (method && method !== DEFLATED)
    throw new Error(`'${path}' in '${zip.name}' is packed in a way that is not known here.`);
  const stream = method ? body.stream().pipeThrough(new DecompressionStream("deflate-raw")) : body.stream();
  const bytes = await new Response(stream).blob().catch(() => null);
  if (bytes?.size !== size) throw new Error(`'${path}' in '${zip.name}' is damaged.`);
  return new File([bytes], path.split("/").pop());
}

// A zip of `entries`, { path, file } each, not packed: it goes to the next machine at once.
export async function zipped(name, entries) {
  const [pieces, list] = [[], []];
  let offset = 0;
  for (const { path, file } of entries) {
    const content = new Uint8Array(await file.arrayBuffer());
    const title = new TextEncoder().encode(path);
    const common = [
      [20, 2],
      [FLAG_UTF8, 2],
      [0, 2],
      [0, 2],
      [0x21, 2], // the first day that a zip can tell: the same files make the same zip
      [crc32(content), 4],
      [content.length, 4],
      [content.length, 4],
      [title.length, 2],
      [0, 2],
    ];
    const local = record([[LOCAL, 4], ...common]);
    pieces.push(local, title, content);
    list.push(record([[ENTRY, 4], [20, 2], ...common, [0, 2], [0, 2], [0, 2], [0, 4], [offset, 4]]), title);
    offset += local.length + title.length + content.length;
  }
  const length = list.reduce((sum, piece) => sum + piece.length, 0);
  const count = entries.length;
  const end = [
    [END, 4],
    [0, 2],
    [0, 2],
    [count, 2],
    [count, 2],
    [length, 4],
    [offset, 4],
    [0, 2],
  ]; // prettier-ignore
  return new File([...pieces, ...list, record(end)], name);
}

function record(fields) {
  const view = new DataView(new ArrayBuffer(fields.reduce((sum, [, size]) => sum + size, 0)));
  let at = 0;
  for (const [value, size] of fields) {
    if (size === 2) view.setUint16(at, value, true);
    else view.setUint32(at, value, true);
    at += size;
  }
  return new Uint8Array(view.buffer);
}

const viewOf = async (blob) => new DataView(await blob.arrayBuffer());

const TABLE = Uint32Array.from({ length: 256 }, (_, byte) => {
  let rest = byte;
  for (let bit = 0; bit < 8; bit += 1) rest = rest & 1 ? (rest >>> 1) ^ 0xedb88320 : rest >>> 1;
  return rest;
});

function crc32(bytes) {
  let rest = 0xffffffff;
  for (const byte of bytes) rest = TABLE[(rest ^ byte) & 0xff] ^ (rest >>> 8);
  return (rest ^ 0xffffffff) >>> 0;
}
