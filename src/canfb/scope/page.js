// Shows what the stream of canfb brings: texts as they come, pictures by uPlot. It sends nothing.
"use strict";
(() => {
  const LONGEST_S = 120;
  const [TIME, POSITION, VELOCITY, RESIDUAL, LIMIT, AMPLITUDE, RAW, FAULTS, INVALID] = [0, 1, 2, 3, 4, 5, 6, 7, 8];
  const by = (name) => document.getElementById(name);
  const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`);
  const past = {};  // of each node, a column for each value of a point
  const curves = {};
  let units = { position: "rev", velocity: "rpm" };
  let last = null;
  let plots = {};
  let built = false;

  const say = (text) => { by("lost").textContent = text; by("lost").hidden = !text; };

  // The token stays in this tab: a cookie would go to each port of this host.
  const token = () => {
    if (location.hash.length > 1) {
      sessionStorage.setItem("canfb", location.hash.slice(1));
      history.replaceState(null, "", location.pathname);
    }
    return sessionStorage.getItem("canfb") ?? "";
  };

  // Texts

  const cell = (kind, parts) => {
    const made = document.createElement(kind);
    for (const [text, tone] of parts) {
      const span = made.appendChild(document.createElement("span"));
      span.textContent = text;
      span.className = tone;
    }
    return made;
  };

  const fill = (table, rows) => table.replaceChildren(...rows.map((cells) => {
    const row = document.createElement("tr");
    row.append(...cells.map((parts, n) => cell(n ? "td" : "th", parts)));
    return row;
  }));

  const plain = (value) => [[value ?? "", ""]];

  const choose = (modules) => {
    const select = by("node");
    const names = modules.map((one) => one.name);
    if (names.join() !== [...select.options].map((one) => one.text).join()) {
      const before = select.value;
      select.replaceChildren(...modules.map((one) => new Option(one.name, one.node)));
      if (modules.some((one) => String(one.node) === before)) select.value = before;
    }
    return modules.find((one) => String(one.node) === select.value);
  };

  const texts = (look, module) => {
    by("name").textContent = `${module.name}  ${module.state}`;
    by("name").className = module.tone;
    by("mapping").textContent = `PDO mapping: ${module.mapping}` + (look.others ? `; other nodes: ${look.others}` : "");
    fill(by("lines"), module.lines.map(([label, parts]) => [plain(label), parts]));
    fill(by("counters"), module.counters.length
      ? [["", "module", "seen here"], ...module.counters].map((row) => row.map(plain)) : []);
    fill(by("emergencies"), module.emergencies.length ? module.emergencies.map((one) => [[one]]) : [[plain("none")]]);
  };

  // Pictures

  const axis = (label) => ({
    ...(label ? { label, labelSize: 20 } : {}), size: label ? 64 : 30, stroke: () => color("faint"), grid: { stroke: () => color("line"), width: 1 },
    ticks: { stroke: () => color("line"), width: 1 },
  });

  const line = (label, name, more = {}) => ({ label, stroke: () => color(name), width: 1.5, points: { show: false }, ...more });

  const shadeInvalid = (plot) => {  // where the position was not valid
    const [times, invalid] = [plot.data[0], past[shown()]?.[INVALID] ?? []];
    plot.ctx.fillStyle = color("shade");
    for (let n = 1; n < times.length; n++) {
      if (!invalid[n]) continue;
      const left = plot.valToPos(times[n - 1], "x", true);
      plot.ctx.fillRect(left, plot.bbox.top, plot.valToPos(times[n], "x", true) - left, plot.bbox.height);
    }
  };

  const overTime = (name, label, columns, series, range) => picture(name, {
    height: name === "faults" ? 120 : 220,
    scales: { x: { time: false }, y: range ? { range } : {} },
    axes: [axis(""), axis(label)],
    series: [{ label: "s" }, ...series],
    hooks: { drawClear: [shadeInvalid] },
  }, columns);

  const picture = (name, options, columns) => {
    const width = Math.max(200, by(name).clientWidth);
    const plot = new uPlot({ width, legend: { live: true }, ...options }, options.series.map(() => []), by(name));
    plots[name] = { plot, columns };
  };

  const fromZero = (plot, low, high) => [0, Math.max(high ?? 0, 1e-3) * 1.1];

  const build = () => {
    for (const { plot } of Object.values(plots)) plot.destroy();
    plots = {};
    overTime("position", units.position, [POSITION], [line("position", "after")]);
    overTime("velocity", units.velocity, [VELOCITY], [line("velocity", "after")]);
    overTime("residual", "cycle", [RESIDUAL, LIMIT],
      [line("peak of 1 s", "after"), line("limit", "bad", { dash: [6, 4] })], fromZero);
    overTime("amplitude", "counts", [AMPLITUDE, RAW], [line("2011:05", "after"), line("ADC, before conditioning", "before")]);
    overTime("faults", "", [FAULTS], [line("faults", "bad", { paths: uPlot.paths.bars({ size: [1, 20] }) })], (plot, low, high) => [0, Math.max(1, high ?? 0)]);
    picture("deviation", {
      height: 240,
      scales: { x: { time: false, range: [0, 1] } },
      axes: [axis("phase, cycles"), axis("% of a cycle")],
      series: [{ label: "phase" },
        line("samples", "faint", { width: 0, paths: () => null, points: { show: true, size: 3, stroke: () => color("faint") } }),
        line("without a table", "before", { spanGaps: true }), line("with the active one", "after", { spanGaps: true })],
    });
  };

  const shown = () => by("node").value;

  const drawTracks = (module) => {
    const canvas = by("tracks");
    const size = canvas.width = canvas.height = canvas.clientWidth * devicePixelRatio;
    const pen = canvas.getContext("2d");
    const most = module.full_scale || Math.max(1, ...module.tracks.flat().map(Math.abs));
    const place = (value) => (1 + value / most) * size / 2;
    pen.strokeStyle = color("line");
    pen.strokeRect(0.5, 0.5, size - 1, size - 1);
    pen.beginPath();
    pen.moveTo(0, size / 2); pen.lineTo(size, size / 2); pen.moveTo(size / 2, 0); pen.lineTo(size / 2, size);
    pen.stroke();
    pen.strokeStyle = color("bad");
    pen.setLineDash(module.assumed.includes("amplitude_limits_counts") ? [2, 5] : [8, 5]);
    for (const limit of module.limits) {
      pen.beginPath();
      pen.arc(size / 2, size / 2, limit / most * size / 2, 0, 2 * Math.PI);
      pen.stroke();
    }
    pen.fillStyle = color("after");
    for (const [sine, cosine] of module.tracks) pen.fillRect(place(cosine) - 1.5, place(-sine) - 1.5, 3, 3);
  };

  const drawDeviation = (curve) => {
    by("curve").textContent = curve.text;
    const [dots, means] = [curve.phase.length, curve.centers.length];
    const x = [...curve.phase, ...curve.centers];
    const order = x.map((_, n) => n).sort((one, other) => x[one] - x[other]);
    const columns = [x, [...curve.deviation, ...Array(means).fill(null)],
      [...Array(dots).fill(undefined), ...curve.before], [...Array(dots).fill(undefined), ...curve.mean]];
    plots.deviation.plot.setData(columns.map((column) => order.map((n) => column[n])));
  };

  const draw = () => {
    const data = past[shown()];
    for (const { plot, columns } of Object.values(plots)) {
      if (columns && data) plot.setData([data[TIME], ...columns.map((column) => data[column])]);
    }
    if (curves[shown()]) drawDeviation(curves[shown()]);
  };

  const resize = () => {
    for (const [name, { plot }] of Object.entries(plots)) plot.setSize({ width: Math.max(200, by(name).clientWidth), height: plot.height });
  };

  // The stream

  const add = (node, point) => {
    const columns = past[node] ??= point.map(() => []);
    const times = columns[TIME];
    if (times.length && point[TIME] < times.at(-1)) columns.forEach((column) => column.length = 0);
    if (times.length && point[TIME] === times.at(-1)) return;
    columns.forEach((column, n) => column.push(point[n]));
    while (times.at(-1) - times[0] > LONGEST_S) columns.forEach((column) => column.shift());
  };

  const begin = ({ data }) => {
    const told = JSON.parse(data);
    units = told.units;
    for (const node of Object.keys(past)) delete past[node];
    for (const [node, points] of Object.entries(told.points)) for (const point of points) add(node, point);
    Object.assign(curves, told.deviations);
    say("");
    built = false;
  };

  const render = () => {
    by("bus").textContent = last.bus.map(([label, parts]) => `${label} ${parts.map(([text]) => text).join("")}`).join("   ");
    const module = choose(last.modules);
    by("note").hidden = Boolean(module);
    document.querySelector("main").hidden = !module;
    if (!module) return;
    if (!built) { build(); built = true; }
    texts(last, module);
    drawTracks(module);
    draw();
    document.body.dataset.looks = Number(document.body.dataset.looks ?? 0) + 1;
  };

  const look = ({ data }) => {
    last = JSON.parse(data);
    for (const one of last.modules) {
      add(one.node, one.point);
      if (one.deviation) curves[one.node] = one.deviation;
    }
    render();
  };

  const connect = () => {
    const stream = new EventSource(`events?${token()}`);
    stream.addEventListener("past", begin);
    stream.addEventListener("look", look);
    stream.onerror = () => say(stream.readyState === EventSource.CLOSED
      ? "Open the address printed at the last start of canfb, with all after the #."
      : "The connection to canfb is lost; the values are old. If canfb has ended, start it again and open the printed address.");
  };

  addEventListener("resize", resize);
  addEventListener("hashchange", () => location.reload());  // another address was opened here: its token
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { built = false; if (last) render(); });
  by("node").addEventListener("change", render);
  addEventListener("DOMContentLoaded", connect);
})();
