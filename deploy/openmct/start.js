"use strict";
// An Open MCT with magcal's plugin alone, as `magcal view --openmct` serves it.

const HOUR = 3600e3;
const magcal = MagcalPlugin({ url: "../telemetry" });
const { stream } = magcal;
const dark = matchMedia("(prefers-color-scheme: dark)").matches;

openmct.setAssetPath("node_modules/openmct/dist");
openmct.install(openmct.plugins.LocalStorage());
openmct.install(openmct.plugins.MyItems());
openmct.install(dark ? openmct.plugins.Espresso() : openmct.plugins.Snow());
openmct.install(openmct.plugins.LADTable());
openmct.install(openmct.plugins.UTCTimeSystem());
openmct.install(magcal);

// What there is to show: a craft of a link, or all of a recording; after 3 s whatever was heard.
const heard = new Promise((resolve) => {
  stream.listen(() => { if (stream.list.length && (stream.origin.kind === "live" || stream.origin.has_ended)) resolve(); });
  stream.heard.then(() => setTimeout(resolve, 3000));
});

// Tables and plots show what is inside of the time: as much as was heard, two hours at most; and the overview of the
// first magnetometer, unless the address asks for something else.
heard.then(() => {
  const { list, newestMs, oldestMs } = stream;
  const back = Math.min(Math.max(newestMs - oldestMs, HOUR / 6), 2 * HOUR);
  openmct.install(openmct.plugins.Conductor({
    menuOptions: [
      { name: "Sample time", timeSystem: "utc", clock: "magcal", clockOffsets: { start: -1.05 * back, end: 0.05 * back } },
      { name: "Fixed", timeSystem: "utc", bounds: { start: newestMs - back, end: newestMs } },
    ],
  }));
  if (list.length && location.hash.length < 3) location.hash = magcal.path(list[0].label);
  openmct.start();
});
