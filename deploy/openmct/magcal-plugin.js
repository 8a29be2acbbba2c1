"use strict";
// Open MCT plugin of magcal: `openmct.install(MagcalPlugin({ url: "http://127.0.0.1:8047/telemetry" }))`.
// It reads the telemetry of one `magcal view`; it writes nothing.  deploy/openmct/README.md says how to use it.

(function (root, factory) {
  if (typeof module === "object" && module.exports) module.exports = factory();
  else root.MagcalPlugin = factory();
})(globalThis, () => {
  const NAMESPACE = "magcal", POINT = "magcal.point", TABLE = "LadTable", PLOT = "telemetry.plot.overlay";
  const ROOT = "_root", CRAFT = "_craft", VERDICTS_OF_ALL = "_verdicts";
  const VERDICTS = ["not started", "converging", "trusted", "doubtful"];
  const RED = "is-limit--upr is-limit--red", YELLOW = "is-limit--upr is-limit--yellow";

  // The telemetry dictionary.  `rows` says which rows of the stream a point is in, `at` in which column of them; a point
  // without rows is what is said now.  Rows are those of magcal_service/views/field.py and history.py.
  const field = (key, name, at) => ({ key, name, unit: "nT", rows: "samples", at });
  const ofResult = (key, name, unit, at, more) => ({ key, name, unit, rows: "results", at, ...more });
  const NINE = ["bx", "by", "bz", "D11", "D22", "D33", "D12", "D13", "D23"].flatMap((name, i) => {
    const [unit, digits] = i < 3 ? ["nT", 1] : ["-", 5];
    return [ofResult(name, name, unit, 1 + i, { digits }), ofResult(`${name}-3sigma`, `${name} 3 sigma`, unit, 10 + i, { digits })];
  });
  const BIAS = NINE.filter(({ key }) => /^b.$/.test(key));
  const FIELD = [field("before", "|B| measured", 1), field("after", "|B| calibrated", 2), field("reference", "|H| reference", 3)];
  const RESIDUAL = [field("residual", "Residual after calibration", 4)];
  const STATE = [
    ofResult("verdict", "Verdict", "", 23, { format: "enum" }),
    { key: "reasons", name: "Reasons and what to do", unit: "", format: "string", said: (now) => [now.result_ms, reasons(now)] },
    { key: "finding", name: "Finding of the watch", unit: "", format: "string", said: (now) => [now.status_ms, finding(now)] },
    ofResult("protection", "Protection level", "nT", 19, { flag: 24, digits: 0 }),
    ofResult("rms", "Residual rms", "nT", 20, { digits: 1 }),
    ofResult("noise", "Noise", "nT", 21, { digits: 1 }),
    ofResult("ticks", "Ticks used", "-", 22, { digits: 0 }),
  ];
  const GROUPS = { state: STATE, nine: NINE, field: [...FIELD, ...RESIDUAL] };
  const GROUP_NAMES = { state: "State", nine: "Nine errors", field: "Field", counters: "Counters" };
  const POINTS = new Map(Object.values(GROUPS).flat().map((point) => [point.key, point]));
  const reasons = (now) => now.reasons.map(([reason, remedy]) => `${reason}: ${remedy}`).join("; ") || "none";
  const finding = (now) => (now.finding ? `${now.finding.what}; run: ${now.finding.command}` : "none");
  const counter = (name) => ({ key: `counter.${coded(name)}`, name, unit: "-", digits: 0, said: (now) => [now.status_ms, now.counters[name]] });

  // A key of Open MCT may hold no "/" or ":", which labels do; keys of the tree's own begin with "_" and a word.
  const coded = (label) => label.replace(/[^A-Za-z0-9-]/gu, (one) => `_${one.codePointAt(0).toString(16)}_`);
  const decoded = (code) => code.replace(/_([0-9a-f]+)_/g, (_, hex) => String.fromCodePoint(parseInt(hex, 16)));

  // What `magcal view` has sent, by magnetometer; it is of bounded size, since the newest rows and every n-th are kept.
  class Stream {
    constructor(url, makeSource) {
      Object.assign(this, { url, makeSource, magnetometers: new Map(), list: [], listeners: new Set(), lost: false, newestMs: 0, oldestMs: 0 });
      this.heard = new Promise((resolve) => { this.resolve = resolve; });
    }

    open() {
      if (this.source) return;
      this.source = this.makeSource(this.url);
      this.source.onmessage = (event) => this.take(JSON.parse(event.data));
      this.source.onerror = () => {
        this.lost = true;
        this.tell();
        if (this.source.readyState === 2) { // refused, not only cut: the browser gives up, this does not
          this.source = null;
          setTimeout(() => this.open(), 2000);
        }
      };
    }

    take(update) {
      this.lost = false;
      this.list = update.list;
      this.origin = update.origin;
      for (const [label, sent] of Object.entries(update.magnetometers)) {
        const one = this.magnetometers.get(label) || { label, samples: {}, results: {} };
        one.now = sent.now;
        if ("start_ms" in sent) one.startMs = sent.start_ms;
        for (const rows of ["samples", "results"]) if (sent[rows]) merge(one[rows], sent[rows]);
        this.magnetometers.set(label, one);
      }
      const times = [...this.magnetometers.values()].flatMap((one) => ["samples", "results"].flatMap((rows) => ends(one, rows)));
      if (times.length) [this.oldestMs, this.newestMs] = [Math.min(...times), Math.max(...times)];
      this.resolve();
      this.tell();
    }

    tell() { for (const listener of [...this.listeners]) listener(); }

    listen(listener) {
      this.listeners.add(listener);
      return () => this.listeners.delete(listener);
    }

    // A recording that has been played does not grow old.  Open MCT leaves out an answer whose time is not a later one.
    staleness(label) {
      const own = this.list.find((one) => one.label === label);
      this.stampMs = Math.max((this.stampMs || 0) + 1, Date.now(), this.newestMs);
      return { isStale: this.lost || !own || (this.origin.kind === "live" && own.is_stale), utc: this.stampMs };
    }
  }

  function merge(kept, sent) {
    for (const [name, most] of [["recent", 900], ["whole", Infinity]]) {
      const { anew, rows } = sent[name];
      kept[name] = (anew ? rows : (kept[name] || []).concat(rows)).slice(-most);
    }
  }

  const msOf = (one, rows, row) => (rows === "samples" ? one.startMs + 1000 * row[0] : row[0]);
  const ends = (one, rows) => [(one[rows].whole || [])[0], (one[rows].recent || []).at(-1)].filter(Boolean).map((row) => msOf(one, rows, row));

  // All rows: of the past every n-th, then each of the newest.
  function allRows({ whole = [], recent = [] }) {
    const from = recent.length ? recent[0][0] : Infinity;
    return [...whole.filter((row) => row[0] < from), ...recent];
  }

  function datum(point, utc, row) {
    const value = row[point.at];
    if (value == null) return [];
    const made = { utc, value };
    if (point.flag) made.unprotected = row[point.flag];
    return [made];
  }

  function said(one, point) {
    const [utc, value] = point.said(one.now);
    return utc == null || value == null ? [] : [{ utc, value }];
  }

  const data = (one, point, rows) => (point.rows ? rows.flatMap((row) => datum(point, msOf(one, point.rows, row), row)) : said(one, point));

  function values(point) {
    const shown = { key: "value", name: "Value", unit: point.unit, hints: { range: 1 } };
    if (point.format === "enum") Object.assign(shown, { format: "enum", enumerations: VERDICTS.map((string, value) => ({ string, value })) });
    else if (point.format === "string") shown.format = "string";
    else shown.formatString = `%0.${point.digits == null ? 1 : point.digits}f`;
    return [shown, { key: "utc", source: "utc", name: "Sample time", format: "utc", hints: { domain: 1 } }];
  }

  // The objects: root, a folder of each craft, of each magnetometer, of each group, and the points; tables, plots and a
  // layout of each magnetometer.  Nothing of it is stored.
  class Tree {
    constructor(stream) { this.stream = stream; }

    static id(...parts) { return { namespace: NAMESPACE, key: parts.join(".") }; }

    // Where a magnetometer's overview is, as an address of Open MCT has it.
    path(label) {
      const { craft } = this.stream.list.find((one) => one.label === label), code = coded(label);
      return "#/browse/" + [ROOT, `${CRAFT}.${coded(craft)}`, code, `${code}.layout`].map((key) => `${NAMESPACE}:${key}`).join("/");
    }

    labels(craft) { return this.stream.list.filter((one) => craft == null || one.craft === craft).map((one) => one.label); }

    find(key) {
      const [code, ...rest] = key.split(".");
      return [this.labels().find((one) => one === decoded(code)), rest.join(".")];
    }

    point(key) {
      if (POINTS.has(key)) return POINTS.get(key);
      return key.startsWith("counter.") ? counter(decoded(key.slice("counter.".length))) : null;
    }

    children(key) {
      const { id } = Tree;
      const [head, ...rest] = key.split(".");
      if (head === ROOT) return [id(VERDICTS_OF_ALL), ...[...new Set(this.stream.list.map((one) => one.craft))].map((craft) => id(CRAFT, coded(craft)))];
      if (head === CRAFT) return this.labels(decoded(rest[0])).map((label) => id(coded(label)));
      const [label, kind] = this.find(key), code = label && coded(label);
      if (label == null) return [];
      if (!kind) return ["layout", "state-table", "nine-table", "field-plot", "residual-plot", "nine-plot", ...Object.keys(GROUP_NAMES)].map((one) => id(code, one));
      if (kind === "counters") return Object.keys(this.stream.magnetometers.get(label).now.counters).map((name) => id(code, counter(name).key));
      return (GROUPS[kind] || []).map((point) => id(code, point.key));
    }

    get(key) {
      const { id } = Tree, made = (type, name, more) => ({ identifier: id(key), type, name, location: this.parent(key), ...more });
      const [head, ...rest] = key.split(".");
      if (head === ROOT) return made("folder", "magcal");
      if (head === CRAFT) return made("folder", decoded(rest[0]));
      if (head === VERDICTS_OF_ALL) return made(TABLE, "Verdicts", table(this.labels().map((label) => id(coded(label), "verdict"))));
      const [label, kind] = this.find(key);
      if (label == null) return made("unknown", `not heard: ${key}`);
      if (!kind) return made("folder", label);
      if (kind in GROUP_NAMES) return made("folder", `${GROUP_NAMES[kind]} of ${label}`);
      const point = this.point(kind);
      if (point) {
        const name = kind === "verdict" ? `Verdict of ${label}` : point.name;
        return made(POINT, name, { telemetry: { values: values(point) } });
      }
      return this.view(label, kind, made);
    }

    parent(key) {
      if (key === ROOT) return "ROOT";
      const parts = key.split("."), [label, kind] = this.find(key);
      let above = ROOT;
      if (label != null && !kind) above = `${CRAFT}.${coded(this.stream.list.find((one) => one.label === label).craft)}`;
      else if (label != null) {
        const group = kind.startsWith("counter.") ? "counters" : Object.keys(GROUPS).find((one) => GROUPS[one].some((point) => point.key === kind));
        above = group ? `${parts[0]}.${group}` : parts[0];
      }
      return `${NAMESPACE}:${above}`;
    }

    view(label, kind, made) {
      const of = (points) => points.map((point) => Tree.id(coded(label), point.key));
      const sub = (one) => Tree.id(coded(label), one);
      if (kind === "state-table") return made(TABLE, `State of ${label}`, table(of(STATE)));
      if (kind === "nine-table") return made(TABLE, `Nine errors of ${label}, now`, table(of(NINE)));
      if (kind === "field-plot") return made(PLOT, `Field magnitude of ${label}`, plot(of(FIELD)));
      if (kind === "residual-plot") return made(PLOT, `Residual of ${label}`, plot(of(RESIDUAL)));
      if (kind === "nine-plot") return made(PLOT, `Bias of ${label}`, plot(of(BIAS)));
      if (kind !== "layout") return made("unknown", `not known: ${kind}`);
      const columns = [["state-table", "nine-table"], ["field-plot", "residual-plot", "nine-plot"]];
      return made("flexible-layout", `Overview of ${label}`, {
        composition: columns.flat().map(sub),
        configuration: {
          rowsLayout: false,
          containers: columns.map((frames, i) => ({
            id: `column-${i}`, size: [40, 60][i],
            frames: frames.map((one) => ({ id: one, domainObjectIdentifier: sub(one), size: Math.floor(100 / frames.length), noFrame: false })),
          })),
        },
      });
    }
  }

  const table = (composition) => ({ composition, configuration: { hiddenColumns: { timestamp: true, type: true } } });
  const plot = (composition) => ({
    composition,
    configuration: { series: composition.map((identifier) => ({ identifier })), legend: { position: "bottom", expanded: false } },
  });

  class Telemetry {
    constructor(stream, tree, limits) { Object.assign(this, { stream, tree, limits }); }

    supports(object) { return object.type === POINT; }
    supportsRequest(object) { return this.supports(object); }
    supportsSubscribe(object) { return this.supports(object); }
    supportsLimits(object) { return this.supports(object); }
    supportsStaleness(object) { return this.supports(object); }

    found(object) {
      const [label, kind] = this.tree.find(object.identifier.key);
      return { one: this.stream.magnetometers.get(label), point: this.tree.point(kind), label };
    }

    async request(object, { start = -Infinity, end = Infinity, strategy, size } = {}) {
      await this.stream.heard;
      const { one, point } = this.found(object);
      if (!one || !point) return [];
      const within = data(one, point, point.rows ? allRows(one[point.rows]) : []).filter(({ utc }) => start <= utc && utc <= end);
      return strategy === "latest" || size === 1 ? within.slice(-1) : within;
    }

    subscribe(object, callback) {
      const newest = ({ one, point }) => (one && point ? data(one, point, point.rows ? one[point.rows].recent || [] : []) : []);
      let lastMs = Math.max(-Infinity, ...newest(this.found(object)).map(({ utc }) => utc));
      return this.stream.listen(() => {
        const rows = newest(this.found(object));
        if (rows.length && rows.at(-1).utc < lastMs) lastMs = -Infinity; // time went back: the source began anew
        for (const one of rows) if (one.utc > lastMs) callback(one);
        if (rows.length) lastMs = rows.at(-1).utc;
      });
    }

    getLimitEvaluator(object) {
      const { point } = this.found(object), above = this.limits.protectionNt;
      return {
        evaluate: (one, shown) => {
          if (!point || (shown && shown.key !== "value")) return undefined;
          if (point.key === "verdict" && one.value === 3) return { cssClass: RED, name: "doubtful", low: 3, high: 3 };
          if (point.key === "verdict" && one.value < 2) return { cssClass: YELLOW, name: "not trusted yet", low: 0, high: 1 };
          if (point.key === "protection" && (one.unprotected || one.value > above)) return { cssClass: RED, name: "unprotected", low: above, high: Infinity };
          return undefined;
        },
      };
    }

    getLimits(object) {
      const { point } = this.found(object), value = this.limits.protectionNt;
      const has = point && point.key === "protection" && isFinite(value);
      return { limits: () => Promise.resolve(has ? { CRITICAL: { high: { color: "red", value } } } : {}) };
    }

    async isStale(object) {
      await this.stream.heard;
      return this.stream.staleness(this.found(object).label);
    }

    subscribeToStaleness(object, callback) {
      const { label } = this.found(object);
      let was = null;
      return this.stream.listen(() => {
        const now = this.stream.staleness(label);
        if (now.isStale !== was) callback(now);
        was = now.isStale;
      });
    }
  }

  // Time as the samples have it: of a recording or of a simulation it is not that of the wall.
  function clock(stream) {
    const listeners = new Map();
    stream.listen(() => { for (const [callback, context] of listeners) callback.call(context, stream.newestMs); });
    return {
      key: "magcal", name: "Sample time", cssClass: "icon-clock", description: "Time of the newest sample that magcal has sent",
      on: (event, callback, context) => { if (event === "tick") listeners.set(callback, context); },
      off: (event, callback) => listeners.delete(callback),
      currentValue: () => stream.newestMs,
    };
  }

  // Plots write their colours into their objects, so a change is kept, as long as the page is open and no longer.
  function kept(tree, stream) {
    const changed = new Map();
    const keep = async (object) => Boolean(changed.set(object.identifier.key, object));
    return {
      get: async ({ key }) => { await stream.heard; return changed.get(key) || tree.get(key); },
      create: keep,
      update: keep,
    };
  }

  function compose(tree, stream) {
    const followers = [];
    return {
      appliesTo: (object) => object.identifier.namespace === NAMESPACE && object.type === "folder",
      load: async (object) => { await stream.heard; return tree.children(object.identifier.key); },
      on: (object, event, callback, context) => {
        if (event !== "add") return;
        const known = new Set(tree.children(object.identifier.key).map((one) => one.key));
        const stop = stream.listen(() => {
          for (const one of tree.children(object.identifier.key)) if (!known.has(one.key)) { known.add(one.key); callback.call(context, one); }
        });
        followers.push({ key: object.identifier.key, callback, stop });
      },
      off: (object, event, callback) => {
        const i = followers.findIndex((one) => one.key === object.identifier.key && one.callback === callback);
        if (i >= 0) followers.splice(i, 1)[0].stop();
      },
    };
  }

  // Options: `url` of the telemetry; `protectionNt`, a level [nT] above which a protection level is red and which plots
  // show as a line (without it, as the daemon's own configuration has it); `makeSource` makes an EventSource of a URL.
  return function MagcalPlugin({ url = "/telemetry", protectionNt = Infinity, makeSource = (one) => new EventSource(one) } = {}) {
    const stream = new Stream(url, makeSource), tree = new Tree(stream);
    const install = (openmct) => {
      openmct.types.addType(POINT, { name: "magcal point", description: "A value over time, from magcal", cssClass: "icon-telemetry" });
      openmct.objects.addRoot(Tree.id(ROOT), openmct.priority.HIGH);
      openmct.objects.addProvider(NAMESPACE, kept(tree, stream));
      openmct.composition.addProvider(compose(tree, stream));
      openmct.telemetry.addProvider(new Telemetry(stream, tree, { protectionNt }));
      openmct.time.addClock(clock(stream));
      stream.open();
    };
    return Object.assign(install, { stream, path: (label) => tree.path(label) });
  };
});
