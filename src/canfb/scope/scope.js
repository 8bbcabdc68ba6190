// Gets a ticket, puts the document of Bokeh into the page, reports the colour scheme, and says why nothing comes.
"use strict";
(() => {
  const told = document.body.dataset;
  const say = (text) => { const lost = document.getElementById("lost"); lost.textContent = text; lost.hidden = false; };
  const RELOAD = "The values are old. Reload the page; if canfb scope has ended, start it again and open the address that it prints.";

  // The policy of the page allows style elements with its nonce alone; Bokeh makes them without one.
  const { nonce } = document.currentScript;
  const create = document.createElement;
  document.createElement = function (...how) {
    const made = create.apply(this, how);
    if (made instanceof HTMLStyleElement) made.nonce = nonce;
    return made;
  };

  // Bokeh keeps to itself why a websocket has ended.
  window.WebSocket = class extends WebSocket {
    constructor(...how) {
      super(...how);
      this.addEventListener("close", () => say(`The connection to canfb scope is lost. ${this.why ?? ""}${RELOAD}`));
    }
    send(data) {
      if ((data.length ?? data.byteLength) <= told.largestMessage) return super.send(data);
      this.why = `The browser was to send ${data.length ?? data.byteLength} bytes at once, and canfb scope takes ${told.largestMessage}. `;
      this.close(4009);
    }
  };

  // Only here, of this host and port: a cookie would go to each port of this host.
  const token = () => {
    if (location.hash.length > 1) {
      sessionStorage.setItem("canfb scope", location.hash.slice(1));
      history.replaceState(null, "", location.pathname);
    }
    return sessionStorage.getItem("canfb scope") ?? "";
  };

  const refuse_large_files = () => {
    const note = document.getElementById("file");
    const judge = (event) => {
      const input = event.target;
      const file = [...input.files ?? []].find((one) => one.size > told.largestFile);
      note.hidden = !file;
      if (!file) return;
      note.textContent = `${file.name} has ${file.size} bytes and was not sent: a table file has at most ${told.largestFile}.`;
      event.stopImmediatePropagation();
      input.value = "";
    };
    const look = (node) => {
      if (node.type === "file") node.getRootNode().addEventListener("change", judge, true);
      for (const one of [...node.shadowRoot?.children ?? [], ...node.children]) look(one);
    };
    look(document.body);
  };

  const show = async () => {
    const answer = await fetch("session", { method: "POST", credentials: "omit", headers: { Authorization: `Bearer ${token()}` } });
    const ticket = await answer.text();
    if (!answer.ok) { say(ticket.replace(/^\d+: /, "")); return; }
    const roots = told.roots.split(" ").map((name) => document.getElementById(`root-${name}`));
    const address = `ws://${location.host}/live/ws`;
    await Bokeh.embed.add_document_from_session(address, ticket, document.body, roots);
    refuse_large_files();
    const dark = Bokeh.documents[0].get_model_by_name("dark");
    const scheme = matchMedia("(prefers-color-scheme: dark)");
    const report = () => { dark.active = scheme.matches; };
    scheme.addEventListener("change", report);
    report();
    told.ready = "true";
  };
  addEventListener("hashchange", () => location.reload());  // another address was opened here: its token
  addEventListener("DOMContentLoaded", () => show().catch((error) => say(`canfb scope does not answer: ${error}`)));
})();
