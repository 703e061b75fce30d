// Files that come and go: drops, downloads, sizes in words.
export const megabytes = (bytes: number) =>
  bytes < 1e6 ? `${Math.ceil(bytes / 1e3)} kB` : `${(bytes / 1e6).toFixed(bytes < 1e7 ? 1 : 0)} MB`;

export function download(name: string, parts: BlobPart[], type = "application/octet-stream") {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob(parts, { type }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

export async function bytesOf(file: Blob) {
  return new Uint8Array(await file.arrayBuffer());
}

// FNV-1a of 64 bits in halves: bytes of photographs are too many for BigInt.
function fnv1a(parts: Uint8Array[]): Uint8Array {
  let low = 0x84222325;
  let high = 0xcbf29ce4;
  for (const part of parts) {
    for (const byte of part) {
      low = (low ^ byte) >>> 0;
      const product = low * 0x1b3;
      high = (Math.imul(high, 0x1b3) + Math.floor(product / 4294967296) + (low << 8)) >>> 0;
      low = product >>> 0;
    }
  }
  return numbers(low, high);
}

function numbers(low: number, high: number) {
  const bytes = new Uint8Array(8);
  const view = new DataView(bytes.buffer);
  view.setUint32(0, low, true);
  view.setUint32(4, high, true);
  return bytes;
}

// A recording as the server writes them (server/base/recording_file.h), which `horopter replay` takes.
export function encodeRecording(about: object, request: Uint8Array, response: Uint8Array): BlobPart[] {
  const encoder = new TextEncoder();
  const parts: Uint8Array[] = [encoder.encode("HOROREC1")];
  for (const part of [encoder.encode(JSON.stringify(about)), request, response]) {
    parts.push(numbers(part.length >>> 0, Math.floor(part.length / 4294967296)), part);
  }
  return [...parts, fnv1a(parts)] as BlobPart[];
}
