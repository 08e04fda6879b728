// Binary messages of the bridge: length of the header, header as JSON, rows of float32.

const decoder = new TextDecoder();

/** ArrayBuffer -> {header, rows: Float32Array of all rows in sequence}. */
export function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(decoder.decode(new Uint8Array(buffer, 4, length)));
  return { header, rows: new Float32Array(buffer, 4 + length) };
}

/** Rows first to first + count of a run, each a view of `width` numbers. */
export function splitRows(rows, width, first, count) {
  const start = first * width;
  return Array.from({ length: count }, (_, n) => rows.subarray(start + n * width, start + (n + 1) * width));
}
