"use strict";
// Updates of the server into the page. Everything heard from a link is put in as text, never as markup.

const SILENT_MS = 4000;
const at = (id) => document.getElementById(id);
const say = (id, text) => { if (at(id).textContent !== text) at(id).textContent = text; };
const element = (name, text, kind) => Object.assign(document.createElement(name), { textContent: text, className: kind || "" });
const MARKS = { trusted: "\u2713 ", doubtful: "! ", converging: "\u2026 ", not_started: "\u2026 " };

const rows = { recent: [], whole: [] };
let span = "recent", source = null, chosen = "", newest = null, heardMs = 0, lines = [], old = false;

const fieldPlot = new Plot(at("field"), [
  { label: "before", colour: "before" }, { label: "after", colour: "after" },
  { label: "reference", colour: "ink", dash: [6, 4] }], clock, "nT");
const residualPlot = new Plot(at("residual"), [{ label: "residual", colour: "after", digits: 1 }], clock, "nT");
const spectrumPlot = new Plot(at("spectrum"), [{ label: "amplitude", colour: "after", digits: 2 }],
  (hz) => (hz === 0 ? "0" : `${(hz * 1000).toPrecision(3)} mHz`), "nT", () => lines);
const sphere = new Sphere(at("sphere"));

function connect(label) {
  if (source) source.close();
  chosen = label;
  source = new EventSource("events?of=" + encodeURIComponent(label));
  source.onmessage = (event) => { heardMs = Date.now(); take(JSON.parse(event.data)); };
  source.onerror = () => { if (source.readyState === EventSource.CLOSED) setTimeout(() => connect(chosen), 2000); };
  source.onopen = () => { newest = null; };
}

function take(update) {
  const shown = update.label;
  if (newest && newest.label !== shown) clear();
  newest = update;
  say("origin", update.origin.kind === "live" ? update.origin.address : `replay of ${update.origin.address}`);
  choices(update.list, shown);
  life();
  if (!update.result) return;
  verdict(update.result);
  nine(update.result);
  told(update.result);
  commands(update);
  if (update.recent) fields(update);
}

function clear() {
  rows.recent = []; rows.whole = [];
  sphere.cells.clear();
  lines = [];
  [[fieldPlot, 3], [residualPlot, 1], [spectrumPlot, 1]].forEach(([plot, n]) => plot.show(Array.from({ length: n + 1 }, () => [])));
  ["field-says", "residual-says", "spectrum-says", "sphere-says"].forEach((id) => say(id, ""));
  sphere.draw();
}

function choices(list, shown) {
  const select = at("choice"), names = list.map((one) => one.label);
  const live = newest.origin.kind === "live";
  const texts = list.map((one) => `${one.label}: ${live && one.is_stale ? "was " : ""}${one.verdict.replace("_", " ")}`);
  if (select.options.length !== names.length || [...select.options].some((one, i) => one.value !== names[i])) {
    select.replaceChildren(...names.map((name) => Object.assign(element("option", name), { value: name })));
    select.value = shown || "";
  }
  [...select.options].forEach((one, i) => { if (one.textContent !== texts[i]) one.textContent = texts[i]; });
}

// What is live, stale, ended or lost; asked again every second, since silence brings no update.
function life() {
  let text = "connecting", kind = "lost", banner = "";
  const silentMs = Date.now() - heardMs;
  if (heardMs && silentMs > SILENT_MS) {
    text = "page lost";
    banner = `No answer from magcal view for ${Math.round(silentMs / 1000)} s; trying again. What is shown is old.`;
  } else if (newest) {
    const own = newest.list.find((one) => one.label === newest.label), { origin } = newest;
    const note = origin.note ? ` ${origin.note}` : "";
    if (!own) {
      text = "waiting";
      banner = origin.has_ended ? `The recording gave nothing.${note}` : `Nothing heard yet.${note}`;
    } else if (origin.kind === "recording") {
      [text, kind] = origin.has_ended ? ["replay ended", "converging"] : ["replaying", "live"];
      banner = note.trim();
    } else if (own.is_stale) {
      text = "stale";
      banner = own.age_s == null ? `No result of ${own.craft} has come yet.${note}`
        : `Nothing new of ${own.craft} for ${Math.round(own.age_s)} s; what is shown is old.${note}`;
    } else if (newest.vectors && newest.vectors.is_stale) {
      text = "no samples";
      banner = `The daemon answers, but calibrated vectors of ${newest.label} stopped ${Math.round(newest.vectors.age_s)} s ago.${note}`;
    } else [text, kind] = ["live", "live"];
  }
  say("life", text);
  at("life").className = "tag " + kind;
  old = kind === "lost" && heardMs > 0;
  document.body.classList.toggle("stale", old);
  if (newest && newest.result) named(newest.result.verdict);
  say("stale", banner);
  at("stale").hidden = !banner;
}

// Elements are made anew only where they change, so that a reader's selection and place stay.
function listed(id, entries, made) {
  const shown = JSON.stringify(entries);
  if (at(id).dataset.shown === shown) return;
  at(id).dataset.shown = shown;
  at(id).replaceChildren(...entries.flatMap(made));
}

// The verdict in words; of old data it is what it was, and has no colour.
function named(verdict) {
  const words = verdict.replace("_", " ");
  say("verdict", old ? `was ${words}` : (MARKS[verdict] || "") + words);
  at("verdict").className = "tag " + (old ? "soft" : verdict);
  const title = `${old ? "was " : ""}${words}: ${newest.label}`;
  if (document.title !== title) document.title = title;
}

function verdict(result) {
  listed("reasons", result.reasons, ([reason, remedy]) => [element("dt", reason), element("dd", remedy)]);
  listed("defects", result.defects, (one) => [element("li", one)]);
  say("protection", result.protection_nt == null ? "Protection level: none now; where none is to come, the status says why."
    : `Protection level: a vector may be off by ${number(result.protection_nt, 0)} nT before anything notices, set by ${result.protection_by}.`);
  at("finding").hidden = !result.finding;
  if (result.finding) { say("found", result.finding.what); say("diagnose", result.finding.command); }
}

function nine(result) {
  listed("nine", result.started ? result.nine : [], ([name, value, limit, unit]) => {
    const row = document.createElement("tr"), head = element("th", name);
    head.scope = "row";
    row.append(head, element("td", value, "n"), element("td", limit, "n"), element("td", unit));
    return [row];
  });
  say("method", result.started ? `${result.method}, ${result.ticks} ticks; residual rms ${number(result.residual_rms_nt, 1)} nT at a noise of ${number(result.noise_nt, 1)} nT`
    : "No estimate yet: only the prior.");
}

function told(result) {
  listed("events", result.events.map(([when, text]) => [Math.abs(when) > 1e8 ? "" : clock(when), text]), ([when, text]) => {
    const item = document.createElement("li");
    item.append(element("time", when), element("span", text));
    return [item];
  });
  say("status", result.status);
  listed("counters", Object.entries(result.counters).filter(([, count]) => count !== 0), ([name, count]) => {
    const pair = document.createElement("div");
    pair.append(element("dt", name), element("dd", count.toLocaleString("en")));
    return [pair];
  });
}

function commands(update) {
  const place = at("commands");
  place.hidden = !update.commands.length;
  if (place.childElementCount === update.commands.length) return;
  place.replaceChildren(...update.commands.map((name) => {
    const button = element("button", name);
    button.type = "button";
    button.addEventListener("click", () => give(name));
    return button;
  }));
}

async function give(name) {
  const { craft } = newest;
  if (name === "reset" && !confirm(`Reset ${craft}: its estimate and verdict begin anew?`)) return;
  const body = JSON.stringify({ craft, name });
  const answer = await fetch("command", { method: "POST", headers: { "Content-Type": "application/json" }, body });
  if (!answer.ok) alert(await answer.text());
}

function fields(update) {
  for (const [name, most] of [["recent", 900], ["whole", Infinity]]) {
    const { anew, rows: added } = update[name];
    rows[name] = anew ? added : rows[name].concat(added);
    if (rows[name].length > most) rows[name] = rows[name].slice(-most);
  }
  times(update.every);
  const last = rows.recent[rows.recent.length - 1];
  sphere.show(update.cells, update.fresh, update.result.started ? update.result.ellipsoid : null, last ? last[3] || last[2] || last[1] : 0);
  say("sphere-says", `${(100 * update.coverage).toFixed(0)} % of all directions have occurred.`);
  at("sphere").setAttribute("aria-label", `Sphere of directions: ${(100 * update.coverage).toFixed(0)} % have occurred`);
  if ("spectrum" in update) spectra(update.spectrum);
}

// Rows with an empty one wherever samples are missing, so that no line is drawn across what nobody measured.
function broken(whole) {
  const steps = whole.slice(1).map((row, i) => row[0] - whole[i][0]), usual = [...steps].sort((a, b) => a - b)[steps.length >> 1];
  return whole.flatMap((row, i) => (i && steps[i - 1] > 5 * usual ? [[row[0] - steps[i - 1] / 2, null, null, null, null], row] : [row]));
}

function times(every) {
  const shown = broken(rows[span]), columns = [0, 1, 2, 3, 4].map((i) => shown.map((row) => row[i]));
  fieldPlot.show(columns.slice(0, 4));
  residualPlot.show([columns[0], columns[4]]);
  const how = span === "whole" && every > 1 ? ` One sample in ${every} is shown.` : "";
  say("field-says", shown.length ? `${clock(columns[0][0])} to ${clock(columns[0][shown.length - 1])} of the samples' own time.${how}` : "");
  const rms = (values) => { const kept = values.filter((v) => v != null); return kept.length ? Math.sqrt(kept.reduce((s, v) => s + v * v, 0) / kept.length) : null; };
  const after = rms(columns[4]), before = rms(shown.map((row) => (row[1] == null || row[3] == null ? null : row[1] - row[3])));
  const lacking = columns[3].some((one) => one != null) ? "There is no estimate yet" : "No reference was heard for these samples";
  say("residual-says", after == null ? `${lacking}, so there is no residual to draw.`
    : `rms ${number(after, 1)} nT after, ${number(before, 1)} nT before, over what is shown.`);
  at("field").setAttribute("aria-label", `Field magnitude before and after calibration against the reference; ${at("residual-says").textContent}`);
  at("residual").setAttribute("aria-label", `Residual over time; ${at("residual-says").textContent}`);
}

function spectra(found) {
  lines = found ? found.lines : [];
  spectrumPlot.show(found ? [found.frequency_hz, found.amplitude_nt] : [[], []]);
  const turn = found && found.turn_hz ? ` The raw vector turns at ${(found.turn_hz * 60).toPrecision(3)} rpm.` : "";
  let text = "Too few samples with an estimate and a reference yet.";
  if (found) {
    const peak = found.amplitude_nt.indexOf(Math.max(...found.amplitude_nt));
    const hz = found.frequency_hz[peak], step = found.frequency_hz[1] - found.frequency_hz[0];
    const named = lines.find(([line]) => Math.abs(line - hz) < 1.5 * step);
    text = `Largest: ${number(found.amplitude_nt[peak], 1)} nT at ${(1000 * hz).toPrecision(3)} mHz${named ? `, ${named[1]}` : ""}.${turn}`;
  }
  say("spectrum-says", text);
  at("spectrum").setAttribute("aria-label", `Spectrum of the residual. ${text}`);
}

function choose(name) {
  span = name;
  for (const one of ["recent", "whole"]) at(one).setAttribute("aria-pressed", String(one === name));
  times(newest ? newest.every : 1);
}

for (const one of ["recent", "whole"]) at(one).addEventListener("click", () => choose(one));
at("choice").addEventListener("change", (event) => { clear(); connect(event.target.value); });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  [fieldPlot, residualPlot, spectrumPlot].forEach((plot) => plot.build());
  sphere.draw();
});
setInterval(life, 1000);
connect("");
