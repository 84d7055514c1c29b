// What the pages of the site do: formulas, pages of results that play, and their colours.
const FROM = new URL(document.currentScript.src);

// Formulas are typeset where there are any; other pages load nothing for them.
const load = (name) =>
  new Promise((done) => {
    const style = name.endsWith(".css");
    const part = document.createElement(style ? "link" : "script");
    Object.assign(part, style ? { rel: "stylesheet", href: new URL(name, FROM) } : { src: new URL(name, FROM) });
    part.addEventListener("load", done);
    document.head.append(part);
  });

async function typeset(body) {
  if (!body.querySelector(".arithmatex")) return;
  await Promise.all([load("katex/katex.min.css"), load("katex/katex.min.js")]);
  await load("katex/auto-render.min.js");
  renderMathInElement(body, {
    delimiters: [
      { left: "\\(", right: "\\)", display: false },
      { left: "\\[", right: "\\]", display: true },
    ],
  });
}

// A page of results has the colours of the site. From a file it cannot be reached, and follows the system.
function match(frame) {
  const page = frame.contentDocument, theme = document.body.dataset.mdColorScheme === "slate" ? "dark" : "light";
  if (page && page.documentElement.dataset.ready && page.documentElement.dataset.theme !== theme) page.getElementById("theme").click();
}

// Show a page once it is ready, in the colours of the site.
function follow(frame) {
  const wait = setInterval(() => {
    const root = frame.contentDocument?.documentElement;
    if (frame.contentDocument && !root?.dataset.ready && frame.isConnected) return;
    clearInterval(wait);
    match(frame);
    frame.dataset.shown = "";
  }, 100);
}

// Results stand as posters until they are wanted: at once those of `data-play="now"`, others under pointer or focus.
function play(poster) {
  if (poster.querySelector("iframe")) return;
  const frame = document.createElement("iframe");
  Object.assign(frame, { src: poster.dataset.page, title: poster.dataset.title, tabIndex: poster.dataset.play ? 0 : -1 });
  follow(frame);
  poster.append(frame);
}

// The theme adds bars of buttons and scrolled tables while a page is read.
function accessible(body) {
  body.querySelectorAll(".md-code__nav:not([aria-label])").forEach((bar) => bar.setAttribute("aria-label", `Copy ${bar.parentElement.id.replaceAll("_", " ")}`));
  body.querySelectorAll(".md-typeset__scrollwrap:not([tabindex])").forEach((table) => (table.tabIndex = 0));
}

// What is folded opens for a link to a part of it, and on paper.
function unfold() {
  const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (!target?.closest("details:not([open])")) return;
  for (let fold = target.closest("details"); fold; fold = fold.parentElement.closest("details")) fold.open = true;
  target.scrollIntoView();
}
addEventListener("hashchange", unfold);
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((fold) => (fold.open = true)));

document$.subscribe(({ body }) => {
  typeset(body);
  accessible(body);
  unfold();
  new MutationObserver(() => accessible(body)).observe(body, { childList: true, subtree: true });
  body.querySelectorAll("iframe").forEach(follow);
  for (const poster of body.querySelectorAll("[data-page]")) {
    if (poster.dataset.play) addEventListener("load", () => setTimeout(() => play(poster), 200), { once: true });
    else if (matchMedia("(hover: hover) and (prefers-reduced-motion: no-preference)").matches) {
      for (const kind of ["pointerenter", "focus"]) poster.addEventListener(kind, () => play(poster));
      for (const kind of ["pointerleave", "blur"]) poster.addEventListener(kind, () => poster.querySelector("iframe")?.remove());
    }
  }
  new MutationObserver(() => body.querySelectorAll("iframe").forEach(match)).observe(body, { attributeFilter: ["data-md-color-scheme"] });
});
