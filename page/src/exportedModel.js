// An exported model in WebAssembly: its memory, its functions, and its arrays by name (see palpate.h of `palpate export`).

const HEADER_BYTES = 64;
const ENTRY_BYTES = 48;
const NAME_BYTES = 24;
const PAGE_BYTES = 65536;
const STACK_BYTES = 1 << 20;
const MODEL_ALIGNMENT = 64; // [B]
const ARRAYS = [Float64Array, Float32Array, BigInt64Array, Uint32Array, Uint8Array, Uint8Array, Int32Array];
// a module of one function with a vector: valid where there is simd128
const VECTORS = new Uint8Array([0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 10, 1, 8, 0, 65, 0, 253, 15, 253, 98, 11]);

const GZIP = [0x1f, 0x8b];
const WASM = [0x00, 0x61, 0x73, 0x6d];
const MAX_PACKINGS = 3; // of a file that a server or a cache has packed again
const beginsWith = (bytes, mark) => mark.every((byte, k) => bytes[k] === byte);

async function unpacked(bytes) {
  const stream = new Response(bytes).body.pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/**
 * The bytes of a file, unpacked. What arrives decides and not its name: a server that declares "Content-Encoding: gzip"
 * lets the browser unpack, and a cache may have packed a packed file again.
 */
async function fetched(url) {
  const response = await fetch(url).catch(() => null);
  let bytes = response?.ok ? await response.arrayBuffer().then((buffer) => new Uint8Array(buffer), () => null) : null;
  if (!bytes) throw new Error(`${url} cannot be read; open the page from a web server, such as python3 -m http.server`);
  for (let k = 0; k < MAX_PACKINGS && bytes && beginsWith(bytes, GZIP); k++) bytes = await unpacked(bytes).catch(() => null);
  if (!bytes) throw new Error(`${url} is damaged: it cannot be unpacked. Export the page again.`);
  return bytes;
}

/** As `fetched`; a server that answers with a page of its own is named. */
async function fetchedAs(url, isRight) {
  const bytes = await fetched(url);
  if (!isRight(bytes)) throw new Error(`${url} is another file: the server must send it as it was exported.`);
  return bytes;
}

/** Load a model from a folder; throws an error for people. */
export async function openModel(folder) {
  if (typeof WebAssembly === "undefined") throw new Error("This browser has no WebAssembly, which the model needs. Update it.");
  const isObject = (bytes) => new TextDecoder().decode(bytes.subarray(0, 1)) === "{";
  const about = JSON.parse(new TextDecoder().decode(await fetchedAs(`${folder}model.json`, isObject)));
  const name = WebAssembly.validate(VECTORS) ? "simd" : "scalar";
  const code = fetchedAs(`${folder}${name}.wasm`, (bytes) => beginsWith(bytes, WASM));
  const [module, content] = await Promise.all([code, fetched(`${folder}model.gz`)]);
  // the memory: constants of the code, the stack, and the model
  const stack = Math.ceil(about.data_end / MODEL_ALIGNMENT) * MODEL_ALIGNMENT + STACK_BYTES;
  const memory = new WebAssembly.Memory({ initial: Math.ceil((stack + about.memory_size) / PAGE_BYTES) });
  const pointer = new WebAssembly.Global({ value: "i32", mutable: true }, stack);
  const given = { __linear_memory: memory, __stack_pointer: pointer };
  const env = new Proxy(given, { get: (_, symbol) => given[symbol] ?? Math[symbol] });
  const { instance } = await WebAssembly.instantiate(module, { env });
  return new ExportedModel(about, instance.exports, memory.buffer, stack, content);
}

class ExportedModel {
  constructor(about, functions, buffer, base, content) {
    Object.assign(this, { about, functions, base });
    const fits = content.length === Number(functions.model_file_size());
    if (fits) new Uint8Array(buffer, base, content.length).set(content);
    if (!fits || this.call("check") !== 0) throw new Error("model.gz is damaged, or of another page. Export both again.");
    this.arrays = this.#arrays(buffer);
  }

  /** Call a function on the memory of the model; returns its status. */
  call(name) {
    return this.functions[`model_${name}`](this.base);
  }

  #arrays(buffer) {
    const view = new DataView(buffer, this.base);
    const arrays = {};
    for (let k = 0; k < view.getUint32(12, true); k++) {
      const at = HEADER_BYTES + ENTRY_BYTES * k;
      const letters = new Uint8Array(buffer, this.base + at, NAME_BYTES);
      const name = String.fromCharCode(...letters.filter((letter) => letter));
      const [type, rows, columns] = [0, 4, 8].map((place) => view.getUint32(at + 32 + place, true));
      arrays[name] = new ARRAYS[type](buffer, this.base + Number(view.getBigUint64(at + NAME_BYTES, true)), rows * columns);
    }
    return arrays;
  }
}
