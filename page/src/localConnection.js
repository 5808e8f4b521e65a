// A connection to a model that this page steps itself, in a worker, in place of a server.
import { decode } from "./protocol.js";

/** The folder of the model that came with this page, or null: it then has a server. */
export const localModel = () => document.querySelector('meta[name="palpate-model"]')?.content ?? null;

/** As `Connection`, but it is never lost. */
export class LocalConnection {
  constructor(folder, on) {
    this.worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
    this.worker.onmessage = ({ data }) => (data instanceof ArrayBuffer ? on.frame(decode(data)) : on.message(data));
    this.worker.onerror = ({ message }) => on.message({ type: "failed", reason: `The model stopped: ${message}` });
    this.send({ type: "open", folder: new URL(`${folder}/`, location.href).href });
  }

  send(message) {
    this.worker.postMessage(message);
  }

  close() {
    this.worker.terminate();
  }

  reconnect() {}
}
