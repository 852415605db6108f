// Reads the data of a replay as scene_drawing.cc writes them.

// Bytes of base64 text.
function bytesOf(text) {
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; ++i) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

// Little-endian doubles.
function doublesOf(text) {
  const bytes = bytesOf(text);
  return new Float64Array(bytes.buffer, 0, bytes.length / 8);
}

// `columns` columns of `rows` numbers each, as one array row by row. A number is a multiple of its column's quantum; a
// column is written as its second differences, each as a variable-length integer whose lowest bit is the sign.
function unpack(packed, rows, columns) {
  const bytes = bytesOf(packed.data);
  const numbers = new Float64Array(rows * columns);
  let at = 0;
  for (let column = 0; column < columns; ++column) {
    const quantum = packed.quanta[column % packed.quanta.length];
    let value = 0, slope = 0;
    for (let row = 0; row < rows; ++row) {
      let code = 0, place = 1, byte;
      do {
        byte = bytes[at++];
        code += (byte & 127) * place;
        place *= 128;
      } while (byte > 127);
      slope += code % 2 === 0 ? code / 2 : -(code + 1) / 2;
      value += slope;
      numbers[row * columns + column] = value * quantum;
    }
  }
  return numbers;
}
