"use strict";
// Runs Open MCT's plugin of magcal without Open MCT: reads {plugin, updates, later} from standard input, gives the
// plugin `updates`, then `later` while it listens, and prints what its providers say.

const input = JSON.parse(require("fs").readFileSync(0, "utf8"));
const MagcalPlugin = require(input.plugin);
const providers = {}, types = [], source = {};
const openmct = {
  priority: { HIGH: 1 },
  types: { addType: (name) => types.push(name) },
  objects: { addRoot: (id) => { providers.root = id; }, addProvider: (_, one) => { providers.objects = one; } },
  composition: { addProvider: (one) => { providers.composition = one; } },
  telemetry: { addProvider: (one) => { providers.telemetry = one; } },
  time: { addClock: (one) => { providers.clock = one; } },
};
const plugin = MagcalPlugin({ makeSource: () => source, ...input.options });
plugin(openmct);
const send = (update) => source.onmessage({ data: JSON.stringify(update) });

async function main() {
  input.updates.forEach(send);
  const { objects, composition, telemetry, clock } = providers, seen = {}, points = {}, live = {}, stale = {}, stops = [];
  const walk = async (id) => {
    const object = await objects.get(id);
    seen[id.key] = { type: object.type, name: object.name, location: object.location };
    if (telemetry.supportsRequest(object)) {
      const all = await telemetry.request(object, { start: 0, end: 1e15 });
      const evaluate = telemetry.getLimitEvaluator(object).evaluate;
      points[id.key] = {
        all,
        part: await telemetry.request(object, input.part),
        latest: await telemetry.request(object, { strategy: "latest", size: 1 }),
        limit: all.length ? (evaluate(all.at(-1), { key: "value" }) || {}).name || "" : "",
        lines: await telemetry.getLimits(object).limits(),
        stale: (await telemetry.isStale(object)).isStale,
      };
      live[id.key] = []; stale[id.key] = [];
      stops.push(telemetry.subscribe(object, (one) => live[id.key].push(one)));
      stops.push(telemetry.subscribeToStaleness(object, (one) => stale[id.key].push(one.isStale)));
    }
    const children = composition.appliesTo(object) ? await composition.load(object) : object.composition || [];
    for (const child of children) if (!(child.key in seen)) await walk(child);
  };
  await walk(providers.root);
  const ticks = [], added = [];
  clock.on("tick", (ms) => ticks.push(ms));
  composition.on(await objects.get(providers.root), "add", (one) => added.push(one.key));
  input.later.forEach(send);
  source.onerror();
  stops.forEach((stop) => stop());
  input.later.forEach(send); // nobody listens any more
  console.log(JSON.stringify({ types, seen, points, live, stale, ticks, added, now: clock.currentValue() }));
}

main();
