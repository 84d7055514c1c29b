"""The viewer as a widget: the page's code in one module, its session in the kernel."""

from __future__ import annotations

import asyncio
import base64
import json
import re
from contextlib import suppress

import pytest
from render_results import write_results
from tipfem.render.viewer import protocol
from tipfem.render.viewer.widget import widget_markup, widget_script

import tipfem as tp

anywidget = pytest.importorskip("anywidget")


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """A results folder of two times."""
    return write_results(tmp_path_factory.mktemp("widget") / "wave", (0.0, 0.1), sharp=True)


def talked(view, said, enough):
    """What a widget sends when its page says something, until there is enough of it."""
    taken = []

    async def run():
        view._repr_mimebundle_()
        view._widget.send = lambda content, buffers=None: taken.append(content.get("text") or buffers[0])
        for text in said:
            view._receive(view._widget, {"text": text}, [])
        with suppress(asyncio.TimeoutError):
            for _ in range(6000):
                await asyncio.sleep(0.02)
                if enough(taken):
                    break
        view.close()
        await view._running

    asyncio.run(run())
    return taken


def test_the_widget_is_sent_what_a_page_is(out):
    view = tp.View(out)
    data, _ = view._repr_mimebundle_()
    assert "application/vnd.jupyter.widget-view+json" in data
    assert data["image/png"].startswith(b"\x89PNG")
    said = ["ready", '{"type": "size", "width": 400, "height": 300}', "{", '{"type": "step", "count": 1}']

    def enough(taken):
        frames = [protocol.unpack(part)[0] for part in taken if isinstance(part, bytes)]
        return any(frame["panes"][0]["index"] == 1 for frame in frames)

    taken = talked(view, said, enough)
    assert enough(taken)
    texts = [json.loads(part)["type"] for part in taken if isinstance(part, str)]
    assert texts[0] == "hello"
    assert "error" in texts
    assert texts[-1] == "bye"


def test_one_module_has_the_pages_code():
    script = widget_script()
    assert not re.search(r"^import ", script, re.MULTILINE)
    assert len(re.findall(r"^export ", script, re.MULTILINE)) == 1
    assert 'data-name="scrub"' in widget_markup()


@pytest.fixture(scope="module")
def taken(out):
    """What a page is sent at first; taken before a browser is there, whose driver keeps asyncio's loop."""
    return talked(tp.View(out), ["ready"], lambda taken: any(isinstance(part, bytes) for part in taken))


@pytest.mark.slow
def test_the_module_runs_in_a_browser_and_shows_a_frame(taken, browser):
    page = browser.new_page(viewport={"width": 900, "height": 800})
    complaints = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto("about:blank")
    page.evaluate(
        """async ([script, markup]) => {
            const at = URL.createObjectURL(new Blob([script], { type: "text/javascript" }));
            const heard = [], said = [];
            const model = { get: (name) => ({ markup, height: 640 })[name], send: (m) => said.push(m.text),
                            on: (_, take) => heard.push(take), off: () => {} };
            const made = await import(at);
            document.body.innerHTML = "<div></div>";
            window.close_ = made.default.render({ model, el: document.querySelector("div") });
            window.say = (text) => heard[0]({ text }, []);
            const bytes = (data) => Uint8Array.from(atob(data), (c) => c.charCodeAt(0));
            window.show = (data) => heard[0]({}, [new DataView(bytes(data).buffer)]);
            window.said = said;
        }""",
        [widget_script(), widget_markup()],
    )
    for part in taken:
        if isinstance(part, str):
            page.evaluate("(text) => say(text)", part)
        else:
            page.evaluate("(data) => show(data)", base64.b64encode(part).decode())
    page.wait_for_selector('.tipfem-viewer.in-notebook:not([data-frame="0"])', timeout=120_000)
    said = page.evaluate("() => said")
    assert said[0] == "ready"
    assert any(json.loads(text)["type"] == "ack" for text in said[1:])
    assert page.inner_text('[data-name="title"]') == "Sloshing"
    # The theme is the notebook's, and no style of the notebook's is drawn into the viewer.
    for theirs, theme in (("false", "dark"), ("true", "light")):
        page.evaluate("(value) => (document.body.dataset.jpThemeLight = value)", theirs)
        page.wait_for_function(f"() => document.querySelector('.tipfem-viewer').dataset.theme === '{theme}'")
    assert page.locator(".progress").count() == 0  # is a bar of Jupyter's
    page.evaluate("() => close_()")
    assert json.loads(page.evaluate("() => said.at(-1)")) == {"type": "visible", "on": False}
    page.close()
    assert complaints == []


def test_without_anywidget_there_is_the_shared_page(out, monkeypatch, browser):
    monkeypatch.setitem(__import__("sys").modules, "anywidget", None)
    data = tp.View(out)._repr_mimebundle_()
    assert "pip install 'tipfem[notebook]'" in data["text/html"]
    page = browser.new_page()
    page.set_content(data["text/html"])
    inner = page.frame_locator("iframe")
    inner.locator("html[data-ready]").wait_for()
    inner.locator("#play").click()
    inner.locator("#clock", has_not_text="t = 0.000 s").wait_for()
    page.close()


def test_what_cannot_be_shown_is_named(tmp_path, out):
    with pytest.raises(ValueError, match="no such folder"):
        tp.View(tmp_path / "none")
    with pytest.raises(ValueError, match="height 10"):
        tp.View(out, height=10)
    assert repr(tp.View(tp.read_results(out), out)) == "View(wave, wave)"


@pytest.mark.slow
def test_a_kernel_answers_the_page(out):
    from jupyter_client.manager import start_new_kernel

    manager, client = start_new_kernel()
    try:
        client.execute(f"import tipfem as tp\nview = tp.View({str(out)!r})\nview")
        comms, shown = [], {}
        while not shown:
            message = client.get_iopub_msg(timeout=300)
            content = message["content"]
            assert message["msg_type"] != "error", content
            if message["msg_type"] == "comm_open" and "_esm" in content["data"]["state"]:
                comms.append(content["comm_id"])
            if message["msg_type"] == "execute_result":
                shown = content["data"]
        assert shown["application/vnd.jupyter.widget-view+json"]["model_id"] == comms[0]
        assert shown["image/png"]

        def say(text):
            data = {"method": "custom", "content": {"text": text}}
            client.shell_channel.send(client.session.msg("comm_msg", {"comm_id": comms[0], "data": data}))

        say("ready")
        say('{"type": "step", "count": 1}')
        kinds, index = [], 0
        while index == 0:
            message = client.get_iopub_msg(timeout=300)
            if message["msg_type"] == "comm_msg" and message["content"]["data"]["method"] == "custom":
                text = message["content"]["data"]["content"].get("text")
                head = json.loads(text) if text else protocol.unpack(bytes(message["buffers"][0]))[0]
                kinds.append(head["type"])
                index = head["panes"][0]["index"] if head["type"] == "frame" else 0
        assert kinds[:2] == ["hello", "status"]
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)
