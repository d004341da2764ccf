// MessagePack of the frames of the server (feed.py), without the types that they do not use. The reader of the
// package @msgpack/msgpack is twelve modules with an encoder; a test compares these lines with Python's msgpack.

const FLOATS = 1; // extension: the readings of a scan, 32-bit floats
const texts = new TextDecoder();

/** The value that a buffer holds. */
export function unpack(buffer) {
  const view = new DataView(buffer);
  let at = 0;
  const skip = (n) => { at += n; return at - n; };
  const unsigned = { 1: (p) => view.getUint8(p), 2: (p) => view.getUint16(p), 4: (p) => view.getUint32(p), 8: (p) => Number(view.getBigUint64(p)) };
  const signed = { 1: (p) => view.getInt8(p), 2: (p) => view.getInt16(p), 4: (p) => view.getInt32(p), 8: (p) => Number(view.getBigInt64(p)) };
  const length = (bytes) => unsigned[bytes](skip(bytes));
  const text = (n) => texts.decode(new Uint8Array(buffer, skip(n), n));
  const list = (n) => Array.from({ length: n }, value);
  const map = (n) => { const found = {}; for (let i = 0; i < n; i += 1) { const key = value(); found[key] = value(); } return found; };
  const extension = (n) => {
    if (view.getInt8(skip(1)) !== FLOATS) throw new Error("unknown extension type");
    return new Float32Array(buffer.slice(skip(n), at));
  };
  function value() {
    const code = view.getUint8(skip(1));
    if (code < 0x80) return code;
    if (code < 0x90) return map(code & 0x0f);
    if (code < 0xa0) return list(code & 0x0f);
    if (code < 0xc0) return text(code & 0x1f);
    if (code >= 0xe0) return code - 0x100;
    if (code >= 0xcc && code <= 0xcf) return length(1 << (code - 0xcc));
    if (code >= 0xd0 && code <= 0xd3) { const n = 1 << (code - 0xd0); return signed[n](skip(n)); }
    if (code >= 0xd4 && code <= 0xd8) return extension(1 << (code - 0xd4));
    switch (code) {
      case 0xc0: return null;
      case 0xc2: return false;
      case 0xc3: return true;
      case 0xc7: case 0xc8: case 0xc9: return extension(length(1 << (code - 0xc7)));
      case 0xca: return view.getFloat32(skip(4));
      case 0xcb: return view.getFloat64(skip(8));
      case 0xd9: case 0xda: case 0xdb: return text(length(1 << (code - 0xd9)));
      case 0xdc: case 0xdd: return list(length(2 << (code - 0xdc)));
      case 0xde: case 0xdf: return map(length(2 << (code - 0xde)));
      default: throw new Error(`unknown MessagePack code ${code}`);
    }
  }
  return value();
}
