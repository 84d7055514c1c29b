// The page of a viewer's own server: a WebSocket with the token of the address, opened again when it is lost.

import { Viewer } from "./viewer.js";

const token = location.hash.slice(1);
const address = new URL("socket", location.href);
address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
address.hash = "";
address.search = new URLSearchParams({ token }).toString();

const ASK_EVERY = 2000, PATIENCE = 5000; // [ms] until a viewer that does not answer is said to be silent

let socket = null, heard = 0, silent = false;
const root = document.querySelector(".tipfem-viewer");
const viewer = new Viewer(root, (text) => socket && socket.readyState === WebSocket.OPEN && socket.send(text), document);
window.addEventListener("hashchange", () => location.reload());

function connect() {
  let opened = false;
  socket = new WebSocket(address);
  socket.binaryType = "arraybuffer";
  socket.addEventListener("open", () => {
    opened = true;
    heard = performance.now();
  });
  socket.addEventListener("message", (event) => {
    heard = performance.now();
    if (silent) viewer.note("");
    silent = false;
    viewer.receive(event.data);
  });
  socket.addEventListener("close", () => {
    silent = false;
    if (viewer.ended) return;
    if (opened) viewer.note("The connection is lost; trying again.", true);
    else viewer.note("The viewer does not answer, or the token in the address is not its own; trying again.", true);
    setTimeout(connect, 2000);
  });
}

// A connection that is up but carries nothing looks like a viewer with nothing to say, unless it is asked.
setInterval(() => {
  if (!socket || socket.readyState !== WebSocket.OPEN || viewer.ended || document.hidden) return;
  if (performance.now() - heard > PATIENCE) {
    silent = true;
    viewer.note("The viewer has not answered for some seconds: the network is slow, or the machine is busy.", true);
  }
  socket.send('{"type": "alive"}');
}, ASK_EVERY);
document.addEventListener("visibilitychange", () => (heard = performance.now()));

if (token) connect();
else viewer.note("This address lacks its token: open the one that was printed, with all that follows the #.", true);
