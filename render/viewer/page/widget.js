// The viewer in the output of a notebook's cell: its messages travel by the widget's model.

export default {
  render({ model, el }) {
    el.innerHTML = model.get("markup");
    const root = el.querySelector(".tipfem-viewer");
    root.style.height = `${model.get("height")}px`;
    root.classList.add("in-notebook");
    root.tabIndex = 0;
    root.dataset.lmSuppressShortcuts = "true"; // JupyterLab's own keys
    const viewer = new Viewer(root, (text) => model.send({ text }), root);
    const take = (message, buffers) => viewer.receive(message.text === undefined ? buffers[0] : message.text);
    model.on("msg:custom", take);
    model.send({ text: "ready" });
    return () => {
      model.off("msg:custom", take);
      viewer.send({ type: "visible", on: false });
      viewer.close();
    };
  },
};
