// The page of a viewer's own server: a WebSocket with the token of the address, opened again when it is lost.

import { Viewer } from "./viewer.js";

const token = location.hash.slice(1);
const address = new URL("socket", location.href);
address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
address.hash = "";
address.search = new URLSearchParams({ token }).toString();

let socket = null;
const root = document.querySelector(".tipfem-viewer");
const viewer = new Viewer(root, (text) => socket && socket.readyState === WebSocket.OPEN && socket.send(text), document);
window.addEventListener("hashchange", () => location.reload());

function connect() {
  let opened = false;
  socket = new WebSocket(address);
  socket.binaryType = "arraybuffer";
  socket.addEventListener("open", () => (opened = true));
  socket.addEventListener("message", (event) => viewer.receive(event.data));
  socket.addEventListener("close", () => {
    if (viewer.ended) return;
    if (opened) viewer.note("The connection is lost; trying again.", true);
    else viewer.note("The viewer does not answer, or the token in the address is not its own; trying again.", true);
    setTimeout(connect, 2000);
  });
}

if (token) connect();
else viewer.note("This address lacks its token: open the one that was printed, with all that follows the #.", true);
