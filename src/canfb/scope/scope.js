// Puts the document of Bokeh into the page, reports the colour scheme, and says when the server is gone.
"use strict";
(async () => {
  const items = [JSON.parse(document.body.dataset.items)];
  await Bokeh.embed.embed_items({}, items);
  const shown = Bokeh.documents[0];
  const dark = shown.get_model_by_name("dark");
  const scheme = matchMedia("(prefers-color-scheme: dark)");
  const report = () => { dark.active = scheme.matches; };
  scheme.addEventListener("change", report);
  report();
  shown.on_event("connection_lost", () => { document.getElementById("lost").hidden = false; });
  document.body.dataset.ready = "true";
})();
