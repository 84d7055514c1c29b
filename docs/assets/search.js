// The theme asks for the index of the search with each page; here its request waits until the search is opened.
{
  const { open, send } = XMLHttpRequest.prototype, search = document.querySelector("[data-md-component=search]");
  XMLHttpRequest.prototype.open = function (method, address, ...others) {
    this.waits = address.endsWith("/search_index.json");
    open.call(this, method, address, ...others);
  };
  XMLHttpRequest.prototype.send = function (...body) {
    const go = () => {
      if (!this.waits) return;
      this.waits = false;
      send.apply(this, body);
    };
    if (!this.waits) return send.apply(this, body);
    if (search.contains(document.activeElement)) return go();
    for (const kind of ["focusin", "pointerenter"]) search.addEventListener(kind, go, { once: true });
  };
}
