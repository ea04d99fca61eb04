// The live page: shows what the server sends (texts.rs) and sends what the user injects.
"use strict";

const SPAN_S = 60; // Time that charts show.
const CHART_EVERY_MS = 200;
const MOST_POSES = 1200;
const STALE_MS = 3000;
const byId = (id) => document.getElementById(id);
const make = (tag, properties = {}, ...children) => {
  const node = Object.assign(document.createElement(tag), properties);
  node.append(...children.filter((child) => child !== null));
  return node;
};
const color = (name) => getComputedStyle(document.body).getPropertyValue(`--${name}`).trim();
const number = (value, digits = 4) => (value === null ? "-" : Number(value.toPrecision(digits)).toString());
// A column whose title begins with a blank is text; the others are numbers.
const table = (columns, rows) => {
  const style = (i) => (columns[i].startsWith(" ") ? "text" : "");
  return make("table", {},
    make("thead", {}, make("tr", {}, ...columns.map((it, i) => make("th", { scope: "col", className: style(i) }, it)))),
    make("tbody", {}, ...rows.map((cells) => make("tr", {}, ...cells.map((cell, i) => (i === 0 ? make("th", { scope: "row" }, cell)
      : make("td", { className: style(i) }, cell ?? "-")))))));
};

let flight = null; // What stays of the flight that is shown.
let poses = [];
let news = null;
let heard = 0; // When the last text came.
let allowsControl = false;
const view = vehicleView(byId("vehicle"));

// Charts

const axis = (values, size, more = {}) => ({
  stroke: () => color("muted"), grid: { stroke: () => color("faint"), width: 1 }, ticks: { show: false },
  font: "12px system-ui", values, size, ...more,
});
const short = (it) => (it === null ? "" : it !== 0 && Math.abs(it) < 1e-3 ? it.toExponential() : number(it, 3));
const SHORT = (_, splits) => splits.map(short);

/// A chart in a figure: its title, its lines as [name, class, properties], and how it reads its data from the page's state.
const charts = [];
const chart = (figure, title, lines, data, scales = {}, axes = null, height = 190) => {
  const keys = lines.filter(([name]) => name).map(([name, className, more]) => make("span", { className: `key ${className}${more?.dash ? " dashed" : ""}` }, name));
  const caption = make("figcaption", {}, make("b", {}, title), ...keys);
  const room = make("div");
  figure.replaceChildren(caption, room);
  const stroke = (className) => () => {
    const probe = make("i", { className });
    document.body.append(probe);
    const found = getComputedStyle(probe).getPropertyValue("--c").trim();
    probe.remove();
    return found.startsWith("var(") ? color(found.slice(6, -1)) : found;
  };
  const series = lines.map(([, className, more]) => ({ stroke: stroke(className), width: 2, points: { show: false }, ...more }));
  const made = new uPlot({
    width: Math.max(100, room.clientWidth), height, pxAlign: 0, legend: { show: false }, cursor: { show: false },
    scales: { x: { time: false }, ...scales }, axes: axes ?? [axis(SHORT, 26, { label: "flight time [s]", labelSize: 16, labelFont: "12px system-ui" }), axis(SHORT, 52)], series: [{}, ...series],
  }, data(), room);
  new ResizeObserver(() => made.setSize({ width: Math.max(100, room.clientWidth), height })).observe(room);
  const shown = { made, figure, update: () => made.setData(data()) };
  charts.push(shown);
  return shown;
};
const recent = () => {
  const last = poses.length ? poses[poses.length - 1].t : 0;
  return poses.filter((pose) => pose.t >= last - SPAN_S);
};
const over = (...values) => () => {
  const shown = recent();
  return [shown.map((pose) => pose.t), ...values.map((value) => shown.map(value))];
};
const REFERENCE = { width: 1.5, dash: [6, 4] };
// A line that does not move has a range, too.
const around = { range: (_, low, high) => {
  const room = Math.max((high - low) * 0.1, Math.abs(high) * 1e-3, 1e-6);
  return [low - room, high + room];
} };

const makeCharts = () => {
  charts.length = 0;
  const zero = { y: { range: (_, low, high) => [0, Math.max(high * 1.1, 1e-4)] } };
  chart(byId("chart-error"), "Position error [m]", [["", "flown"]], over((it) => it.e), zero);
  const axes = ["x", "y", "z"];
  chart(byId("chart-position"), "Position [m]", [...axes.map((it) => [it, it]), ...axes.map((it, i) => [i ? "" : "reference", it, REFERENCE])],
    over(...axes.map((_, i) => (it) => it.p[i]), ...axes.map((_, i) => (it) => it.r[i])), { y: around });
  chart(byId("chart-yaw"), "Yaw [rad]", [["is", "yaw"], ["reference", "yaw", REFERENCE]], over((it) => it.yaw, (it) => it.ryaw), { y: around });
  chart(byId("chart-rotors"), "Rotor commands [rad/s]", [0, 1, 2, 3].map((i) => [`${i + 1}`, `rotor-${i + 1}`]), over(...[0, 1, 2, 3].map((i) => (it) => it.w[i])), { y: around });
  const room = byId("estimates");
  room.replaceChildren();
  if (flight.no_estimates) room.append(make("p", {}, `There are no estimates to compare: ${flight.no_estimates}.`));
  else flight.estimated.forEach(([name, unit], i) => {
    const figure = room.appendChild(make("figure"));
    chart(figure, `${name.replace(/_(kg|nm|rad)_.*/, "").replaceAll("_", " ")} [${unit}]`, [["estimated", "inner"], ["true", "inner", REFERENCE]],
      over((it) => it.th && it.th[i], (it) => it.true[i]), { y: around });
  });
  histogram("loop", "Loop", ["loop"]);
  histogram("hop", "Hops", ["outer", "inner", "mixer"]);
  histogram("wake", "Wake-ups", ["plant", "outer", "inner", "mixer"]);
};

const seriesOf = (kind) => (news?.flight?.series ?? []).filter((it) => it.name.split(".")[0] === kind);
const microseconds = (us) => (us === null ? "-" : us >= 1000 ? `${number(us / 1000, 3)} ms` : `${number(us, 3)} us`);
// Counts over logarithmic bins of 1/12 of a decade; empty bins stand at the foot.
const histogram = (kind, title, classes) => {
  const FOOT = 0.5, step = 10 ** (1 / 12);
  const data = () => {
    const all = seriesOf(kind);
    const edges = all.flatMap((it) => it.bins.map(([edge]) => Math.round(12 * Math.log10(edge))));
    if (!edges.length) return [[1, 100], ...classes.map(() => [null, null])];
    const [low, high] = [Math.min(...edges) - 1, Math.max(...edges) + 2];
    const bins = Array.from({ length: high - low + 1 }, (_, i) => low + i);
    return [bins.map((it) => step ** it), ...classes.map((_, i) => {
      const counts = new Map((all[i]?.bins ?? []).map(([edge, count]) => [Math.round(12 * Math.log10(edge)), count]));
      return bins.map((it) => counts.get(it) ?? FOOT);
    })];
  };
  const figure = byId(`hist-${kind}`);
  const isDecade = (it) => it > 0 && Number.isInteger(Math.round(Math.log10(it) * 1e6) / 1e6);
  // A label of the time axis needs 50 px.
  const decades = (plot, splits, axis) => {
    const room = axis === 0 ? plot.bbox.width / devicePixelRatio / 50 : Infinity;
    const every = Math.ceil(splits.filter(isDecade).length / room) || 1;
    let count = 0;
    return splits.map((it) => (isDecade(it) && count++ % every === 0 ? it : null));
  };
  const line = { paths: uPlot.paths.stepped({ align: 1 }), width: 1.8 };
  const shown = chart(figure, `${title}: ticks by time, both logarithmic`, classes.map((it) => ["", it, line]), data,
    { x: { time: false, distr: 3 }, y: { distr: 3, range: (_, low, high) => [FOOT, Math.max(10, high * 1.5)] } },
    [axis((_, s) => s.map((it) => (it === null ? "" : microseconds(it))), 26, { filter: decades }), axis((_, s) => s.map((it) => (it === null ? "" : `${it}`)), 52, { filter: decades })], 190);
  const room = figure.appendChild(make("div"));
  shown.after = () => room.replaceChildren(table(["", "p50", "p99", "p99.9", "max"], seriesOf(kind).map((it, i) => [
    make("span", { className: `key ${classes[i]}` }, it.name.replace("_", " to ")),
    ...[it.p50, it.p99, it.p999, it.max].map(microseconds)])));
};

let drawn = 0;
const draw = () => {
  if (document.hidden || performance.now() - drawn < CHART_EVERY_MS) return;
  drawn = performance.now();
  charts.filter((it) => !it.after).forEach((it) => it.update());
};

// Texts of the server

const show = {
  flight: (text) => {
    byId("instance").textContent = text.instance;
    document.title = `ironbird ${text.instance}`;
    allowsControl = text.allows_control;
    byId("read-only").hidden = allowsControl;
    byId("control").hidden = !allowsControl;
    const isOther = flight?.run !== text.flight?.run;
    flight = text.flight ?? null;
    byId("connecting").hidden = true;
    byId("waiting").hidden = flight !== null;
    byId("content").hidden = flight === null;
    if (!flight) return tile("phase", { word: "waiting", why: "", tone: "open" });
    poses = flight.poses;
    const [trajectory, gains, outer, inner, mixer] = flight.conditions;
    byId("conditions").textContent = `${trajectory}, gains ${gains}; laws ${outer}, ${inner}, ${mixer}${flight.channels > 1 ? `; ${flight.channels} channels` : ""}`;
    view.reference(flight.reference);
    view.path(poses.map((it) => it.p));
    view.marks([]);
    if (isOther) {
      byId("answers").replaceChildren();
      makeCharts();
      makeParameters();
      makeFaults();
    }
    if (poses.length) showPose(poses[poses.length - 1]);
  },
  pose: (pose) => {
    if (!flight) return;
    const last = poses[poses.length - 1];
    if (!last || pose.t >= last.t + 0.0999) {
      poses.push(pose);
      if (poses.length > MOST_POSES) poses.shift();
      view.path(poses.map((it) => it.p));
    }
    showPose(pose);
    draw();
  },
  news: (text) => {
    news = text;
    if (flight && text.flight) showNews(text.flight);
  },
  answer: (text) => {
    const waiting = requests.get(text.id);
    requests.delete(text.id);
    waiting?.(text.ok, text.text);
  },
};

const showPose = (pose) => {
  view.draw({ position: pose.p, attitude: pose.q, reference: pose.r, rotors: pose.w.map((it) => it / (2 * flight.hover_rad_s)) });
  byId("clock").textContent = `${pose.t.toFixed(1)} of ${number(flight.duration_s, 5)} s`;
  byId("progress").value = pose.t / flight.duration_s;
  const [is, should] = byId("pose").tBodies[0].rows;
  [...pose.p, pose.yaw].forEach((it, i) => { is.cells[i + 1].textContent = it.toFixed(3); });
  [...pose.r, pose.ryaw].forEach((it, i) => { should.cells[i + 1].textContent = it.toFixed(3); });
};

const tile = (name, { word, why, tone }) => {
  const box = byId(`tile-${name}`), [shownWord, shownWhy] = box.querySelectorAll("dd");
  box.className = tone;
  if (shownWord.textContent !== word) shownWord.textContent = word;
  if (shownWhy.textContent !== why) shownWhy.textContent = why;
};

const showNews = (it) => {
  const [track, timing, theorem] = it.verdicts;
  tile("phase", it.phase);
  tile("track", track);
  tile("timing", timing);
  tile("theorem", theorem);
  const isOver = it.phase.is_over;
  const { broken } = it, why = broken.length ? [...broken] : ["all processes run, no fault acts"];
  if (it.changed.length) why.push(`changed: ${it.changed.join(", ")}`);
  tile("broken", isOver ? { word: "-", why: "no flight", tone: "open" } : {
    word: broken.length ? `${broken.length} thing${broken.length > 1 ? "s" : ""}` : "nothing", why: why.join("\n"), tone: broken.length ? "bad" : "good",
  });
  if (isOver) {
    const status = it.status ? `${it.status}. ` : "";
    banner(`The flight ${it.phase.word === "lost" ? "was lost" : "has ended"}: ${it.phase.why}. ${status}${it.report ? `Report: ${it.report}` : "The report is in the flight's directory."}`, true);
  } else banner("");
  charts.filter((shown) => shown.after).forEach((shown) => { shown.update(); shown.after(); });
  const loop = seriesOf("loop")[0];
  byId("latency-note").textContent = loop ? `${loop.count} ticks since the page's server joined the flight. ${it.lost ? `${it.lost} messages were not seen.` : ""}` : "";
  showMisses(it);
  showChannels(it);
  const event = (it) => make("li", { title: `tick ${it.tick}`, className: it.kind }, make("span", {}, `${it.time_s.toFixed(3)} s`), it.text);
  byId("events").replaceChildren(...(it.events.length ? it.events.map(event) : [make("li", {}, "", "none yet")]));
  showMarks(it.events);
  showParameters(it.parameters);
  byId("acting").replaceChildren(...it.faults.map(([what, rest]) => make("button", {
    type: "button", onclick: () => what.split(",").filter((part) => !part.endsWith("=off")).forEach((part) => inject(`${part.split("=")[0]}=off`)),
    disabled: isOver, title: "ends the fault",
  }, `end ${what}${rest === null ? "" : ` (${rest.toFixed(1)} s more)`}`)));
};

// The newest faults and handovers stand where the vehicle was, as far back as its path goes.
const showMarks = (events) => {
  const APART_S = 0.5;
  const marked = events.filter((it) => ["fault", "process", "handover"].includes(it.kind));
  const apart = marked.filter((it, i) => i + 1 === marked.length || it.time_s - marked[i + 1].time_s > APART_S).slice(0, 4);
  view.marks(apart.flatMap(({ time_s, text }) => {
    const isKnown = poses.length && poses[0].t <= time_s + APART_S;
    const pose = isKnown && poses.find((it) => it.t >= time_s);
    return pose ? [{ position: pose.p, color: "red", label: text }] : [];
  }));
};

const showMisses = (it) => {
  byId("misses").textContent = `${it.not_fresh} ticks without a fresh command on time; ${it.missed} deadlines missed, ${it.skipped} ticks skipped`;
  const room = byId("outages"), found = it.outages;
  if (!found) return room.replaceChildren(make("p", { className: "note" }, "The recorder has written no causes yet."));
  const pending = found.pending ? [["not classified yet", "-", "-", found.pending]] : [];
  const classes = [...found.classes.map((c) => [c.cause, c.stage ?? "-", c.outages, c.missed]), ...pending];
  const worst = found.worst.map((o) => [`${o.time_s.toFixed(3)} s`, o.ticks, o.missed,
    `${o.cause}${o.stage ? `, ${o.stage}` : ""}. ${o.evidence}${o.faults.length ? ` (fault ${o.faults.join(", ")})` : ""}`]);
  room.replaceChildren(classes.length ? table(["cause", " stage", "outages", "missed"], classes) : make("p", {}, "No outage so far."),
    worst.length ? make("h3", {}, "The worst") : "", worst.length ? table(["at", "ticks", "missed", " cause and evidence"], worst) : "");
};

const showChannels = (it) => {
  const { redundancy } = it, isOver = it.phase.is_over;
  const counts = `processes: ${it.failed} failed, ${it.restarted} restarted`;
  const flown = Object.entries(redundancy?.ticks_flown ?? {}).map((it) => it.join(" ")).join(", ");
  byId("channels").replaceChildren(...(redundancy ? [make("b", {}, `Channel ${redundancy.active} flies`), `, ${redundancy.handovers} handovers; ticks flown: ${flown}; ${counts}`] : [counts]));
  const outages = redundancy?.outages.map((o) => [o.channel, o.tick, o.ticks, `${o.reason}${o.handover ? "; handed over" : ""}`]) ?? [];
  const switches = redundancy?.switchovers?.map((s) => [`${s.from} to ${s.to}`, s.tick, "-", `switchover: ${s.reason}`]) ?? [];
  const rows = [...switches, ...outages];
  byId("channel-outages").replaceChildren(rows.length ? table(["channel", "tick", "ticks out", " why"], rows) : "");
  byId("processes").replaceChildren(table(["process", "number", " phase", "ticks", "skipped", "stale"], it.processes.map((p) => [
    p.name, p.pid, isOver ? "ended" : p.missing ? make("span", { className: "bad-text" }, "missing") : p.phase, p.ticks, p.skipped, p.stale])));
};

// Changes by the user

const requests = new Map();
let nextRequest = 1;
let socket = null;
const request = (what, after, answered) => {
  if (socket?.readyState !== WebSocket.OPEN) return answered(false, "no connection");
  const id = nextRequest++;
  requests.set(id, answered);
  socket.send(JSON.stringify(after ? { id, inject: what, after } : { id, inject: what }));
};
const inject = (what, after = null) => {
  const item = make("li", {}, `${what}${after ? ` in ${after}` : ""}: waits for the plant`);
  byId("answers").prepend(item);
  while (byId("answers").children.length > 4) byId("answers").lastChild.remove();
  request(what, after, (ok, text) => {
    item.className = ok ? "good-text" : "bad-text";
    item.textContent = `${what}: ${text}`;
  });
};

const makeFaults = () => {
  const button = ({ label, inject: parts, meaning, lasts }) => make("button", {
    type: "button", title: `${parts[0][0]}: ${meaning}`,
    onclick: () => parts.forEach(([what, after]) => inject(what + (lasts ? byId("lasts").value : ""), after)),
  }, label);
  byId("faults").replaceChildren(...flight.faults.map(({ name, buttons }) =>
    make("div", { className: buttons.length > 4 ? "many" : "" }, make("b", {}, name), ...buttons.map((it) => {
      const made = button(it);
      made.setAttribute("aria-label", `${name}: ${it.label}`);
      return made;
    }))));
};
byId("free").addEventListener("submit", (event) => {
  event.preventDefault();
  if (byId("what").value.trim()) inject(byId("what").value.trim());
});

// A slider of 1000 steps; logarithmic where the range spans decades.
const makeParameters = () => {
  byId("parameters").replaceChildren(...flight.parameters.map((it) => {
    const isLog = it.min > 0 && it.max / it.min >= 50;
    const toPlace = (value) => 1000 * (isLog ? Math.log(value / it.min) / Math.log(it.max / it.min) : (value - it.min) / (it.max - it.min));
    const atPlace = (place) => (isLog ? it.min * (it.max / it.min) ** (place / 1000) : it.min + (it.max - it.min) * place / 1000);
    const toValue = (place) => Math.min(it.max, Math.max(it.min, Number(atPlace(place).toPrecision(3))));
    const id = `parameter-${it.name}`, disabled = !allowsControl;
    const slider = make("input", { type: "range", id, min: 0, max: 1000, step: 1, disabled });
    const exact = make("input", { type: "text", inputMode: "decimal", disabled });
    exact.setAttribute("aria-label", `${it.name}, exact value`);
    const nominal = make("button", { type: "button", disabled, title: `back to ${it.nominal}` }, "nominal");
    nominal.setAttribute("aria-label", `${it.name} nominal`);
    const shown = make("output", { htmlFor: id });
    const answer = make("small", { className: "answer" });
    answer.setAttribute("aria-live", "polite");
    const box = make("div", { className: "parameter" }, make("label", { htmlFor: id, title: it.meaning }, it.name), shown, slider,
      allowsControl ? make("div", { className: "buttons" }, exact, nominal) : "",
      make("small", {}, `${it.meaning}; nominal ${number(it.nominal)}, ${number(it.min)} to ${number(it.max)}${it.unit ? ` ${it.unit}` : ""}`), answer);
    const send = (value) => {
      box.isWaiting = true;
      answer.className = "answer";
      answer.textContent = "waits for the plant";
      request(`${it.name}=${value}`, null, (ok, text) => {
        box.isWaiting = false;
        answer.className = `answer ${ok ? "good-text" : "bad-text"}`;
        answer.textContent = text;
        if (!ok) box.show(box.value);
      });
    };
    slider.addEventListener("input", () => { shown.value = `${number(toValue(slider.value))} ${it.unit}`; });
    slider.addEventListener("change", () => send(toValue(slider.value)));
    exact.addEventListener("change", () => send(exact.value.trim()));
    nominal.addEventListener("click", () => send("nominal"));
    box.show = (value) => {
      box.value = value;
      box.classList.toggle("changed", value !== it.nominal);
      if (box.isWaiting || slider.matches(":active")) return;
      slider.value = toPlace(value);
      if (document.activeElement !== exact) exact.value = number(value);
      shown.value = `${number(value)} ${it.unit}`;
      slider.setAttribute("aria-valuetext", shown.value);
    };
    return box;
  }));
};
const showParameters = (values) => [...byId("parameters").children].forEach((box, i) => {
  if (box.value !== values[i] || box.value === undefined) box.show(values[i]);
});

// The connection

const banner = (text, isCalm = false) => {
  const box = byId("banner");
  box.hidden = !text;
  box.classList.toggle("calm", isCalm);
  if (box.textContent !== text) box.textContent = text;
};
const UNKNOWN = { word: "unknown", why: "the page has no connection", tone: "bad" };
const lose = (why) => {
  banner(why);
  if (news?.flight?.phase.is_over === false) ["phase", "track", "timing", "broken", "theorem"].forEach((it) => tile(it, UNKNOWN));
  requests.forEach((answered) => answered(false, "the connection was lost before the answer"));
  requests.clear();
};
const connect = () => {
  socket = new WebSocket(`ws://${location.host}${location.pathname}live`);
  socket.onmessage = (event) => {
    heard = performance.now();
    const text = JSON.parse(event.data);
    show[text.kind](text);
  };
  socket.onclose = ({ code, reason }) => {
    if (code === 1001 && news?.flight?.phase.is_over) {
      return banner(`${byId("banner").textContent} This page's server has ended, too.`, true);
    }
    if (code === 1001) return lose(`${reason}: start it again and open its new address.`);
    lose(`No connection to ironbird${reason ? `: ${reason}` : ""}. Trying again; if it was started anew, open its new address.`);
    setTimeout(connect, 1000);
  };
};
setInterval(() => {
  if (socket.readyState === WebSocket.OPEN && performance.now() - heard > STALE_MS) lose("ironbird sends nothing.");
}, 1000);
const narrow = matchMedia("(max-width: 900px)");
const foldParameters = () => { byId("all-parameters").open = !narrow.matches; };
narrow.addEventListener("change", foldParameters);
foldParameters();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => charts.forEach((it) => it.made.redraw()));
connect();
