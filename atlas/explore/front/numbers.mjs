// Unpacks arrays of cells from bytes; numbers.py packs them.

const TYPES = { float64: Float64Array, int32: Int32Array, int8: Int8Array, uint8: Uint8Array, uint16: Uint16Array };

/** Return the bytes that deflated bytes contain. */
export async function inflated(packed) {
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Return the array that packed bytes contain: numbers of a numpy type, in rows of `width` numbers. */
export async function unpacked(packed, type, width) {
  const planes = await inflated(packed), Type = TYPES[type];
  const size = Type.BYTES_PER_ELEMENT, bytes = new Uint8Array(planes.length);
  for (let plane = 0, at = 0; plane < size; plane++)
    for (let k = plane; k < bytes.length; k += size) bytes[k] = planes[at++];
  summed(bytes, size, width);
  return new Type(bytes.buffer);
}

function summed(bytes, size, width) {
  const count = bytes.length / size;
  if (size < 8) {
    const whole = new { 1: Uint8Array, 2: Uint16Array, 4: Uint32Array }[size](bytes.buffer);
    for (let k = width; k < count; k++) whole[k] += whole[k - width];
    return;
  }
  const half = new Uint32Array(bytes.buffer); // the lower half of each number comes first
  for (let k = 2 * width; k < 2 * count; k += 2) {
    const low = half[k] + half[k - 2 * width];
    half[k + 1] += half[k + 1 - 2 * width] + (low > 0xffffffff ? 1 : 0);
    half[k] = low;
  }
}
