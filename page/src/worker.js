// The worker of a page without a server: steps an exported model in real time, and speaks the protocol of the server.
import { openModel } from "./exportedModel.js";
import { LocalSession } from "./localSession.js";

let session = null;
let opening = [];

const post = (message) => (message instanceof ArrayBuffer ? postMessage(message, [message]) : postMessage(message));

onmessage = async ({ data }) => {
  if (data.type === "open") {
    try {
      session = new LocalSession(await openModel(data.folder), post);
      for (const message of opening) session.handle(message);
      opening = [];
    } catch (error) {
      post({ type: "failed", reason: error.message });
    }
  } else if (session) session.handle(data);
  else opening.push(data);
};
