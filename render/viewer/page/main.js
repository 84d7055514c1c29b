// The page of a viewer's own server: a WebSocket with the token of the address, opened again when it is lost.

import { Viewer } from "./viewer.js";

// After the token the address says what is seen: the time, the field and the window, so that it can be kept and shared.
const [token, ...rest] = location.hash.slice(1).split("&");
let wanted = new URLSearchParams(rest.join("&"));
const address = new URL("socket", location.href);
address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
address.hash = "";
address.search = new URLSearchParams({ token }).toString();

const ASK_EVERY = 2000, PATIENCE = 5000; // [ms] until a viewer that does not answer is said to be silent

let socket = null, heard = 0, silent = false;
const root = document.querySelector(".tipfem-viewer");
const viewer = new Viewer(root, (text) => socket && socket.readyState === WebSocket.OPEN && socket.send(text), document);
viewer.met = () => {
  const see = wanted;
  wanted = new URLSearchParams(); // what is seen after a lost connection is the viewer's to say
  if (!viewer.steers) return;
  if (see.has("field")) viewer.send({ type: "field", name: see.get("field") });
  if (see.has("t")) viewer.send({ type: "show", time: Number(see.get("t")) });
  if (see.has("window")) viewer.setWindow(see.get("window").split(",").map(Number));
};
viewer.told = ({ time, field, window: part, playing }) => {
  if (playing) return;
  const seen = [token];
  if (!viewer.hello.live) seen.push(`t=${Number(time.toPrecision(6))}`);
  if (field) seen.push(`field=${encodeURIComponent(field)}`);
  if (part) seen.push(`window=${part.map((value) => Number(value.toPrecision(5))).join()}`);
  if (location.hash.slice(1) !== seen.join("&")) history.replaceState(null, "", `#${seen.join("&")}`);
};
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
