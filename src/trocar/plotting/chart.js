// Charts that share one range of time. CHARTS: [{title, unit, warnings, curves: [{label, color,
// held, t, v}]}], with t and v as little-endian float32 in base64.
const LEFT = 58, RIGHT = 6, TOP = 20, BOTTOM = 18;

function floats(text) {
  return new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
}

for (const chart of CHARTS) {
  for (const curve of chart.curves) {
    curve.t = floats(curve.t);
    curve.v = floats(curve.v);
  }
}
const every = CHARTS.flatMap((chart) => chart.curves);
const START = Math.min(...every.map((c) => c.t[0]));
const END = Math.max(...every.map((c) => c.t[c.t.length - 1]), START + 1e-3);
let from = START, to = END, pointer = null, drag = null;

// The index of the last sample at or before a time; 0 before the first.
function at(t, time) {
  let low = 0, high = t.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (t[middle] <= time) low = middle; else high = middle - 1;
  }
  return low;
}

function ticks(low, high, most) {
  const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * power).find((k) => k >= rough);
  const digits = Math.min(9, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high; k++) {
    found.push([k * step, (k * step).toFixed(digits)]);
  }
  return found;
}

function draw(canvas) {
  const chart = CHARTS[canvas.dataset.chart], ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight, pen = canvas.getContext("2d");
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  pen.scale(ratio, ratio);
  pen.font = "11px system-ui, sans-serif";
  let low = Infinity, high = -Infinity;
  const spans = chart.curves.map(({ t, v }) => {
    const span = [at(t, from), Math.min(at(t, to) + 1, t.length - 1)];
    for (let k = span[0]; k <= span[1]; k++) {
      if (v[k] < low) low = v[k];
      if (v[k] > high) high = v[k];
    }
    return span;
  });
  if (!(low <= high)) [low, high] = [-1, 1];
  const room = Math.max(0.06 * (high - low), 1e-3 - 0.5 * (high - low));
  low -= room;
  high += room;
  const x = (time) => LEFT + ((time - from) / (to - from)) * (width - LEFT - RIGHT);
  const y = (value) => height - BOTTOM - ((value - low) / (high - low)) * (height - TOP - BOTTOM);
  // The mean over `half` samples to both sides, weighted as a triangle.
  const mean = (t, v, first, last, half) => {
    pen.beginPath();
    for (let k = first; k <= last; k += Math.max(1, half >> 1)) {
      let sum = 0, weights = 0;
      for (let j = Math.max(first, k - half); j <= Math.min(last, k + half); j++) {
        const weight = 1 + half - Math.abs(j - k);
        sum += weight * v[j];
        weights += weight;
      }
      pen.lineTo(x(t[k]), y(sum / weights));
    }
    pen.stroke();
  };
  pen.strokeStyle = "#dddddd";
  pen.fillStyle = "#51606f";
  pen.lineWidth = 0.7;
  for (const [value, text] of ticks(low, high, 4)) {
    pen.strokeRect(LEFT, y(value), width - LEFT - RIGHT, 0);
    pen.textAlign = "right";
    pen.fillText(text, LEFT - 5, y(value) + 4);
  }
  for (const [time, text] of ticks(from, to, 6)) {
    pen.strokeRect(x(time), TOP, 0, height - TOP - BOTTOM);
    pen.textAlign = "center";
    pen.fillText(text, x(time), height - 4);
  }
  pen.save();
  pen.beginPath();
  pen.rect(LEFT, TOP, width - LEFT - RIGHT, height - TOP - BOTTOM);
  pen.clip();
  pen.setLineDash([4, 3]);
  pen.strokeStyle = "#E69F00";
  for (const time of chart.warnings) pen.strokeRect(x(time), TOP, 0, height);
  pen.setLineDash([]);
  pen.lineWidth = 1.1;
  chart.curves.forEach(({ t, v, color, held }, index) => {
    const [first, last] = spans[index];
    const dense = !held && last - first > 2 * (width - LEFT - RIGHT);
    pen.strokeStyle = color;
    pen.globalAlpha = dense ? 0.25 : 1;
    pen.beginPath();
    for (let k = first; k <= last; k++) {
      if (held && k > first) pen.lineTo(x(t[k]), y(v[k - 1]));
      pen.lineTo(x(t[k]), y(v[k]));
    }
    pen.stroke();
    pen.globalAlpha = 1;
    if (dense) mean(t, v, first, last, Math.round((2 * (last - first)) / (width - LEFT - RIGHT)));
  });
  pen.restore();
  if (pointer !== null) {
    pen.strokeStyle = "#51606f";
    pen.strokeRect(x(pointer), TOP, 0, height - TOP - BOTTOM);
  }
  let place = LEFT;
  const write = (text, color) => {
    pen.textAlign = "left";
    pen.fillStyle = color;
    pen.fillText(text, place, 12);
    place += pen.measureText(text).width + 8;
  };
  write(`${chart.title} [${chart.unit}]`, "#1d2733");
  for (const { label, color, t, v } of chart.curves) {
    write(pointer === null ? label : `${label} ${v[at(t, pointer)].toPrecision(5)}`, color);
  }
  if (pointer !== null) write(`at ${pointer.toFixed(3)} s`, "#51606f");
}

const canvases = [...document.querySelectorAll("canvas[data-chart]")];
let due = false;
function redraw() {
  if (due) return;
  due = true;
  requestAnimationFrame(() => {
    due = false;
    for (const canvas of canvases) {
      const box = canvas.getBoundingClientRect();
      if (box.bottom > -200 && box.top < window.innerHeight + 200) draw(canvas);
    }
  });
}

function show(begin, end) {
  const length = Math.min(Math.max(end - begin, 2e-3), END - START);
  from = Math.min(Math.max(begin, START), END - length);
  to = from + length;
  redraw();
}

for (const canvas of canvases) {
  const time = (event) => {
    const box = canvas.getBoundingClientRect();
    const share = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
    return from + Math.min(Math.max(share, 0), 1) * (to - from);
  };
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const middle = time(event), factor = Math.exp(0.0015 * event.deltaY);
    show(middle - factor * (middle - from), middle + factor * (to - middle));
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => {
    drag = { x: event.clientX, from, to };
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    pointer = time(event);
    if (drag !== null) {
      const wide = canvas.clientWidth - LEFT - RIGHT;
      const by = ((drag.x - event.clientX) / wide) * (drag.to - drag.from);
      show(drag.from + by, drag.to + by);
    }
    redraw();
  });
  canvas.addEventListener("pointerup", () => { drag = null; });
  canvas.addEventListener("pointerleave", () => { pointer = null; redraw(); });
  canvas.addEventListener("dblclick", () => show(START, END));
}
window.addEventListener("resize", redraw);
window.addEventListener("scroll", redraw);
redraw();
