// Whole numbers of a size [bytes] as `packing.turned` writes them.
export function turned(bytes, from, count, size) {
  const found = new Int32Array(count);
  for (let k = 0; k < count; k++) {
    let number = 0;
    for (let byte = 0; byte < size; byte++) number |= bytes[from + byte * count + k] << (8 * byte);
    found[k] = (number >>> 1) ^ -(number & 1);
  }
  return found;
}
