'use strict';
// Draws the figures of the report, all linked by one time cursor and one time range.

const data = JSON.parse(document.getElementById('data').textContent);
const SVG = 'http://www.w3.org/2000/svg';
const STATES = {TRACKING: 'good', ACQUIRING: 'warn', LOST: 'bad',
  'TRACKING, no attitude': 'other',
  used: 'good', checked: 'warn', excluded: 'bad'};
const view = {from: 0, to: data.duration || 1, cursor: null};
const figures = [];

function make(parent, name, attributes, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes || {})) {
    element.setAttribute(key, value);
  }
  if (text !== undefined) {
    element.textContent = text;
  }
  parent.append(element);
  return element;
}

function makeHtml(parent, name, className, text) {
  const element = document.createElement(name);
  element.className = className || '';
  if (text !== undefined) {
    element.textContent = text;
  }
  parent.append(element);
  return element;
}

// Ticks at round values, about as many as fit.
function ticks(low, high, count) {
  const span = high - low;
  if (!(span > 0)) {
    return {values: [low], decimals: 3};
  }
  const power = 10 ** Math.floor(Math.log10(span / count));
  const step = [1, 2, 5, 10].map((factor) => factor * power)
    .find((candidate) => span / candidate <= count) || 10 * power;
  const values = [];
  // Counted from the first: numbers too large for the step cannot keep the loop going.
  const first = Math.ceil(low / step - 1e-9);
  for (let index = 0; index <= count && (first + index) * step <= high + step * 1e-9; index += 1) {
    values.push((first + index) * step);
  }
  return {values, decimals: Math.max(0, Math.min(9, -Math.floor(Math.log10(step) + 1e-9)))};
}

function shown(value, decimals, circle) {
  const turned = circle ? ((value % circle) + circle) % circle : value;
  return turned.toFixed(decimals).replace(/^-(0(\.0*)?)$/, '$1').replace('-', '\u2212');
}

function readable(value, circle) {
  const turned = circle ? ((value % circle) + circle) % circle : value;
  const size = Math.abs(turned);
  const decimals = circle ? 4 : size >= 100 ? 1 : size >= 10 ? 2 : size >= 0.1 ? 3 : 4;
  return shown(turned, Number.isInteger(turned) && !circle ? 0 : decimals);
}

// Index of the sample nearest to a time; times are sorted.
function nearest(times, time) {
  let low = 0;
  let high = times.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time) {
      low = middle;
    } else {
      high = middle;
    }
  }
  return Math.abs(times[high] - time) < Math.abs(times[low] - time) ? high : low;
}

// Usual distance of samples: further apart, they are not joined.
function spacing(times) {
  const steps = [];
  for (let index = 1; index < times.length; index += 1) {
    steps.push(times[index] - times[index - 1]);
  }
  steps.sort((a, b) => a - b);
  return steps.length ? steps[steps.length >> 1] : data.duration || 1;
}

function extent(panel) {
  let low = panel.zero ? 0 : Infinity;
  let high = panel.zero ? 0 : -Infinity;
  for (const series of panel.series) {
    if (series.hidden) {
      continue;
    }
    for (let index = 0; index < series.t.length; index += 1) {
      const value = series.y[index];
      if (value === null || series.t[index] < view.from || series.t[index] > view.to) {
        continue;
      }
      low = Math.min(low, series.kind === 'band' ? -value : value);
      high = Math.max(high, value);
    }
  }
  if (panel.range && low <= high) {
    low = Math.max(low, panel.range[0]);
    high = Math.min(high, panel.range[1]);
  }
  if (!(low <= high)) {
    return [0, 1];
  }
  const margin = 0.06 * (high - low) || Math.abs(high) * 0.01 || 1;
  return [panel.zero ? 0 : low - margin, high + margin];
}

function curve(series, x, y) {
  const gap = 3.5 * series.step;
  const parts = [];
  let pieces = [];
  let last = -Infinity;
  const close = () => {
    if (series.kind === 'band' && pieces.length) {
      const upper = pieces.map(([t, v]) => `${x(t)} ${y(v)}`);
      const lower = pieces.reverse().map(([t, v]) => `${x(t)} ${y(-v)}`);
      parts.push(`M${upper.concat(lower).join('L')}Z`);
    } else if (pieces.length) {
      parts.push(`M${pieces.map(([t, v]) => `${x(t)} ${y(v)}`).join('L')}`);
    }
    pieces = [];
  };
  for (let index = 0; index < series.t.length; index += 1) {
    const time = series.t[index];
    const value = series.y[index];
    if (value === null || time < view.from - gap || time > view.to + gap) {
      close();
    } else if (series.kind === 'dots') {
      parts.push(`M${x(time)} ${y(value)}h0`);
    } else {
      if (time - last > gap) {
        close();
      }
      pieces.push([time, value]);
    }
    last = time;
  }
  close();
  return parts.join('');
}

function setCursor(time) {
  view.cursor = time === null ? null : Math.min(view.to, Math.max(view.from, time));
  document.getElementById('cursor').value = view.cursor === null ? view.from : view.cursor;
  document.getElementById('cursor-time').textContent =
    view.cursor === null ? 'no cursor' : `t = ${view.cursor.toFixed(2)} s`;
  figures.forEach((figure) => figure.point());
}

function setView(from, to) {
  const end = data.duration || 1;
  const span = Math.min(end, Math.max(to - from, end / 5000));
  view.from = Math.min(Math.max(0, from), end - span);
  view.to = view.from + span;
  const slider = document.getElementById('cursor');
  slider.min = view.from;
  slider.max = view.to;
  slider.step = span / 1000;
  figures.forEach((figure) => figure.draw());
  setCursor(view.cursor !== null && view.cursor >= view.from && view.cursor <= view.to
    ? view.cursor : null);
}

// What all figures over time share: size, time axis, cursor line, pointer and keys.
function timeFigure(holder, label, heightOf, paint, tell) {
  const svg = make(holder, 'svg', {tabindex: 0, role: 'img', 'aria-label': label});
  const readout = makeHtml(holder, 'div', 'readout');
  const figure = {};
  let box = null;
  let line = null;
  const timeAt = (event) => {
    const place = event.clientX - svg.getBoundingClientRect().left;
    const ratio = (place - box.left) / (box.right - box.left);
    return view.from + Math.min(1, Math.max(0, ratio)) * (view.to - view.from);
  };
  figure.draw = () => {
    const width = Math.max(220, holder.clientWidth);
    const height = heightOf(width);
    box = {left: 56, right: width - 10, top: 8, bottom: height - 20};
    svg.setAttribute('width', width);
    svg.setAttribute('height', height);
    svg.replaceChildren();
    const x = (time) => +(box.left + (time - view.from) / (view.to - view.from)
      * (box.right - box.left)).toFixed(2);
    const axis = make(svg, 'g', {class: 'axis'});
    const {values, decimals} = ticks(view.from, view.to, width / 80);
    for (const value of values) {
      make(axis, 'line', {x1: x(value), x2: x(value), y1: box.top, y2: box.bottom});
      make(axis, 'text', {x: x(value), y: height - 6, 'text-anchor': 'middle'},
        `${shown(value, decimals)} s`);
    }
    paint(svg, axis, box, x);
    line = make(svg, 'line', {class: 'cursor', y1: box.top, y2: box.bottom});
    figure.x = x;
    figure.point();
  };
  figure.point = () => {
    if (!line) {
      return;
    }
    line.setAttribute('visibility', view.cursor === null ? 'hidden' : 'visible');
    if (view.cursor === null) {
      readout.textContent = '';
      return;
    }
    line.setAttribute('x1', figure.x(view.cursor));
    line.setAttribute('x2', figure.x(view.cursor));
    readout.textContent = tell(view.cursor);
  };
  let start = null;
  let chosen = null;
  svg.addEventListener('pointermove', (event) => {
    setCursor(timeAt(event));
    if (start !== null && event.pointerType === 'mouse') {
      chosen = chosen || make(svg, 'rect', {class: 'chosen', y: box.top,
        height: box.bottom - box.top});
      const ends = [figure.x(start), figure.x(view.cursor)].sort((a, b) => a - b);
      chosen.setAttribute('x', ends[0]);
      chosen.setAttribute('width', ends[1] - ends[0]);
    }
  });
  svg.addEventListener('pointerdown', (event) => {
    start = timeAt(event);
    setCursor(start);
    if (event.pointerType === 'mouse') {
      svg.setPointerCapture(event.pointerId);
    }
  });
  const end = (event) => {
    const from = start;
    start = null;
    if (chosen) {
      chosen.remove();
      chosen = null;
      const to = timeAt(event);
      if (event.type === 'pointerup' && Math.abs(figure.x(to) - figure.x(from)) > 6) {
        setView(Math.min(from, to), Math.max(from, to));
      }
    }
  };
  svg.addEventListener('pointerup', end);
  svg.addEventListener('pointercancel', end);
  svg.addEventListener('dblclick', () => setView(0, data.duration || 1));
  svg.addEventListener('keydown', (event) => {
    const step = (view.to - view.from) / (event.shiftKey ? 10 : 200);
    const now = view.cursor === null ? view.from : view.cursor;
    if (event.key === 'ArrowRight' || event.key === 'ArrowLeft') {
      setCursor(now + (event.key === 'ArrowRight' ? step : -step));
      event.preventDefault();
    } else if (event.key === 'Escape') {
      setCursor(null);
    }
  });
  figures.push(figure);
  return figure;
}

function tellSeries(panel, time) {
  const words = [];
  for (const series of panel.series) {
    if (series.hidden || !series.t.length) {
      continue;
    }
    const index = nearest(series.t, time);
    const near = Math.abs(series.t[index] - time) <= 1.5 * series.step;
    const value = near ? series.y[index] : null;
    const sign = series.kind === 'band' ? '\u00b1' : '';
    words.push(`${series.name} ${value === null ? '\u2013'
      : `${sign}${readable(value, panel.circle)}${panel.unit ? ` ${panel.unit}` : ''}`}`);
  }
  return words.join(' \u00b7 ');
}

function plotPanel(holder, panel) {
  panel.series.forEach((series, index) => {
    series.colour = `k${(series.kind === 'band' ? 0 : index) % 5}`;
    series.step = spacing(series.t);
  });
  // Bands and the dots within them are of one colour.
  if (panel.series.length > 1 && panel.series[0].kind === 'band') {
    panel.series[panel.series.length - 1].colour = 'k0';
  }
  const head = makeHtml(holder, 'div', 'head');
  makeHtml(head, 'strong', '', panel.unit ? `${panel.title} [${panel.unit}]` : panel.title);
  const figure = timeFigure(holder, `${panel.title} over time`,
    (width) => (width < 500 ? 150 : 175),
    (svg, axis, box, x) => {
      const [low, high] = extent(panel);
      const y = (value) => +(box.bottom - (value - low) / (high - low)
        * (box.bottom - box.top)).toFixed(2);
      const {values, decimals} = ticks(low, high, 5);
      for (const value of values) {
        make(axis, 'line', {x1: box.left, x2: box.right, y1: y(value), y2: y(value)});
        make(axis, 'text', {x: box.left - 5, y: y(value) + 4, 'text-anchor': 'end'},
          shown(value, decimals, panel.circle));
      }
      const clip = `clip-${panel.id}`;
      make(make(svg, 'clipPath', {id: clip}), 'rect', {x: box.left, y: box.top,
        width: box.right - box.left, height: box.bottom - box.top});
      const inside = make(svg, 'g', {'clip-path': `url(#${clip})`});
      for (const series of panel.series) {
        if (!series.hidden) {
          make(inside, 'path', {class: `${series.kind} ${series.colour}`,
            d: curve(series, x, y), 'data-series': series.name});
        }
      }
    },
    (time) => tellSeries(panel, time));
  for (const series of panel.series) {
    const button = makeHtml(head, 'button', '');
    makeHtml(button, 'span', `swatch ${series.kind} ${series.colour}`);
    button.append(series.name);
    button.type = 'button';
    button.setAttribute('aria-pressed', 'true');
    button.addEventListener('click', () => {
      series.hidden = !series.hidden;
      button.setAttribute('aria-pressed', String(!series.hidden));
      figure.draw();
    });
  }
}

function plotStates(holder, states, words) {
  const at = (time) => states.findLast((part) => part.from <= time);
  timeFigure(holder, words, () => 64, (svg, axis, box, x) => {
    for (const part of states) {
      const left = Math.max(box.left, x(part.from));
      const right = Math.min(box.right, x(part.to));
      if (right < box.left || left > box.right) {
        continue;
      }
      const bar = make(svg, 'rect', {class: `state ${STATES[part.state] || 'other'}`, x: left,
        y: box.top, width: Math.max(1, right - left), height: box.bottom - box.top});
      make(bar, 'title', {}, `${part.state}, ${part.from.toFixed(2)} to ${part.to.toFixed(2)} s`);
    }
  }, (time) => (at(time) ? at(time).state : 'state not known'));
  const head = makeHtml(holder, 'p', 'faint');
  for (const state of new Set(states.map((part) => part.state))) {
    const total = states.filter((part) => part.state === state)
      .reduce((sum, part) => sum + part.to - part.from, 0);
    makeHtml(head, 'span', `swatch ${STATES[state] || 'other'}`);
    head.append(`${state} ${total.toFixed(1)} s   `);
  }
}

function plotHistogram(holder, histogram) {
  makeHtml(holder, 'strong', '', `${histogram.title} [arcsec]`);
  const svg = make(holder, 'svg', {role: 'img', 'aria-label': `errors about ${histogram.title}`});
  const summary = `mean ${readable(histogram.mean)}, rms ${readable(histogram.rms)} arcsec`
    + (histogram.outside ? `, ${histogram.outside} outside` : '');
  const readout = makeHtml(holder, 'div', 'readout', summary);
  const {edges, counts, expected} = histogram;
  const draw = () => {
    const width = Math.max(200, holder.clientWidth);
    const height = 170;
    svg.setAttribute('width', width);
    svg.setAttribute('height', height);
    svg.replaceChildren();
    const most = Math.max(1, ...counts, ...(expected || []));
    const x = (value) => 34 + (value - edges[0]) / (edges.at(-1) - edges[0]) * (width - 44);
    const y = (value) => height - 20 - value / most * (height - 30);
    const axis = make(svg, 'g', {class: 'axis'});
    const across = ticks(edges[0], edges.at(-1), width / 70);
    for (const value of across.values) {
      make(axis, 'text', {x: x(value), y: height - 5, 'text-anchor': 'middle'},
        shown(value, across.decimals));
    }
    const up = ticks(0, most, 4);
    for (const value of up.values) {
      make(axis, 'line', {x1: 34, x2: width - 10, y1: y(value), y2: y(value)});
      make(axis, 'text', {x: 29, y: y(value) + 4, 'text-anchor': 'end'},
        shown(value, up.decimals));
    }
    counts.forEach((count, index) => {
      const left = x(edges[index]);
      const bar = make(svg, 'rect', {class: 'bar', x: left + 0.5, y: y(count),
        width: Math.max(1, x(edges[index + 1]) - left - 1), height: y(0) - y(count)});
      const show = () => {
        svg.querySelectorAll('.lit').forEach((other) => other.classList.remove('lit'));
        bar.classList.add('lit');
        readout.textContent = `${readable(edges[index])} to ${readable(edges[index + 1])}: `
          + `${count} frames${expected ? `, ${expected[index].toFixed(1)} expected` : ''}`;
      };
      bar.addEventListener('pointerenter', show);
      bar.addEventListener('pointerdown', show);
    });
    if (expected) {
      make(svg, 'path', {class: 'expected', 'pointer-events': 'none', d: `M${expected.map(
        (value, index) => `${x((edges[index] + edges[index + 1]) / 2)} ${y(value)}`).join('L')}`});
    }
  };
  svg.addEventListener('pointerleave', () => {
    svg.querySelectorAll('.lit').forEach((other) => other.classList.remove('lit'));
    readout.textContent = summary;
  });
  figures.push({draw, point: () => {}});
}

// Vectors are [x, y, z]; quaternions are [x, y, z, w].
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0]];

function rotate(q, vector) {
  const once = cross(q, vector).map((value, index) => value + q[3] * vector[index]);
  return cross(q, once).map((value, index) => vector[index] + 2 * value);
}

function unit(raDeg, decDeg) {
  const [ra, dec] = [raDeg * Math.PI / 180, decDeg * Math.PI / 180];
  return [Math.cos(dec) * Math.cos(ra), Math.cos(dec) * Math.sin(ra), Math.sin(dec)];
}

function radec(vector) {
  const ra = Math.atan2(vector[1], vector[0]) * 180 / Math.PI;
  return [(ra + 360) % 360,
    Math.atan2(vector[2], Math.hypot(vector[0], vector[1])) * 180 / Math.PI];
}

// Stereographic about a centre, or Hammer of the whole sky; east is left. null: not on the map.
function projection(sky, size) {
  const [ra0, dec0] = radec(sky.centre);
  const half = size / 2;
  if (sky.wholeSky) {
    return (vector) => {
      const [ra, dec] = radec(vector);
      const lon = (((ra - ra0 + 540) % 360) - 180) * Math.PI / 180;
      const lat = dec * Math.PI / 180;
      const z = Math.sqrt(1 + Math.cos(lat) * Math.cos(lon / 2));
      return [half - 0.98 * half * Math.cos(lat) * Math.sin(lon / 2) / z,
        half / 2 - 0.98 * half / 2 * Math.sin(lat) / z];
    };
  }
  const east = unit(ra0 + 90, 0);
  const north = cross(sky.centre, east);
  const scale = 0.98 * half / Math.tan(sky.radiusDeg * Math.PI / 360);
  return (vector) => {
    const depth = 1 + dot(vector, sky.centre);
    return depth < 0.05 ? null : [half - scale * dot(vector, east) / depth,
      half - scale * dot(vector, north) / depth];
  };
}

function polyline(vectors, project, size, closed) {
  let path = '';
  let last = null;
  for (const vector of closed ? vectors.concat([vectors[0]]) : vectors) {
    const point = project(vector);
    // Broken where the map ends on one side and goes on on the other.
    const joined = point && last && Math.hypot(point[0] - last[0], point[1] - last[1]) < size / 3;
    if (point) {
      path += `${joined ? 'L' : 'M'}${point[0].toFixed(1)} ${point[1].toFixed(1)}`;
      path += joined ? '' : 'h0';
    }
    last = point;
  }
  return path;
}

function drawGraticule(svg, sky, project, size) {
  const step = sky.wholeSky ? 30 : [1, 2, 5, 10, 15, 30].find((s) => sky.radiusDeg / s <= 5) || 30;
  const [ra0, dec0] = radec(sky.centre);
  const polar = Math.abs(dec0) + sky.radiusDeg > 80;
  const raStep = polar ? 30 : Math.min(30, [1, 2, 5, 10, 15, 30].find(
    (s) => s >= step / Math.cos(dec0 * Math.PI / 180)) || 30);
  const grid = make(svg, 'g', {class: 'graticule'});
  const names = make(svg, 'g', {'pointer-events': 'none'});
  const raSpan = sky.wholeSky || polar ? 180
    : Math.min(180, 1.1 * sky.radiusDeg / Math.cos(dec0 * Math.PI / 180));
  const write = (vector, text, anchor) => {
    const point = project(vector);
    if (point && point[0] > 0 && point[0] < size && point[1] > 8 && point[1] < size) {
      make(names, 'text', {class: 'label', x: point[0] + 3, y: point[1] - 3,
        'text-anchor': anchor}, text);
    }
  };
  for (let ra = Math.ceil((ra0 - raSpan) / raStep) * raStep; ra < ra0 + raSpan; ra += raStep) {
    const meridian = [];
    for (let dec = -90; dec <= 90; dec += 1) {
      meridian.push(unit(ra, dec));
    }
    make(grid, 'path', {d: polyline(meridian, project, size)});
    // On the map of the whole sky every second meridian has its name on the equator.
    if (!sky.wholeSky || ra % 60 === 0) {
      const named = Math.abs(dec0) > 75 ? Math.sign(dec0) * 75 : dec0;
      write(unit(ra, sky.wholeSky ? 0 : named), `${((ra % 360) + 360) % 360}\u00b0`, 'start');
    }
  }
  for (let dec = -90 + step; dec < 90; dec += step) {
    if (!sky.wholeSky && Math.abs(dec - dec0) > sky.radiusDeg + step) {
      continue;
    }
    const parallel = [];
    for (let ra = -raSpan; ra <= raSpan; ra += Math.max(raSpan / 90, 0.05)) {
      parallel.push(unit(ra0 + ra, dec));
    }
    make(grid, 'path', {d: polyline(parallel, project, size)});
    write(unit(ra0, dec), `${dec > 0 ? '+' : dec < 0 ? '\u2212' : ''}${Math.abs(dec)}\u00b0`,
      'start');
  }
}

function plotSky(holder, sky) {
  const svg = make(holder, 'svg', {role: 'img', 'aria-label': 'path of the boresight on the sky'});
  const readout = makeHtml(holder, 'div', 'readout');
  const step = spacing(sky.t);
  let project = null;
  let field = null;
  let here = null;
  let chosen = '';
  const draw = () => {
    const size = Math.min(holder.clientWidth, 680);
    const height = sky.wholeSky ? size / 2 : size;
    svg.setAttribute('width', size);
    svg.setAttribute('height', height);
    svg.replaceChildren();
    project = projection(sky, size);
    const clip = make(svg, 'clipPath', {id: 'clip-sky'});
    const shape = {cx: size / 2, cy: height / 2, rx: size / 2 - 1, ry: height / 2 - 1};
    make(clip, 'ellipse', shape);
    const inside = make(svg, 'g', {'clip-path': 'url(#clip-sky)'});
    drawGraticule(inside, sky, project, size);
    make(svg, 'ellipse', {...shape, class: 'horizon'});
    for (const [x, y, z, magnitude, hip, frames] of sky.stars) {
      const point = project([x, y, z]);
      if (!point) {
        continue;
      }
      const star = make(inside, 'circle', {class: frames ? 'sky-star used' : 'sky-star',
        cx: point[0].toFixed(1), cy: point[1].toFixed(1),
        r: Math.max(0.6, (sky.wholeSky ? size / 300 : 4.4) - 0.5 * magnitude).toFixed(1)});
      const words = `HIP ${hip}, V ${magnitude}, `
        + (frames ? `used in ${frames} frames` : 'not used');
      make(star, 'title', {}, words);
      star.addEventListener('pointerenter', () => { chosen = words; tell(); });
      star.addEventListener('pointerleave', () => { chosen = ''; tell(); });
    }
    make(inside, 'path', {class: 'path', 'pointer-events': 'none',
      d: polyline(sky.q.map((q) => rotate(q, [0, 0, 1])), project, size)});
    field = make(inside, 'path', {class: 'field', 'pointer-events': 'none'});
    here = make(inside, 'circle', {class: 'here', r: 4, 'pointer-events': 'none'});
    tell();
  };
  const tell = () => {
    if (!project) {
      return;
    }
    const time = view.cursor === null ? sky.t.at(-1) : view.cursor;
    const index = nearest(sky.t, time);
    const known = Math.abs(sky.t[index] - time) <= Math.max(1.5 * step, 1e-3);
    here.setAttribute('visibility', known ? 'visible' : 'hidden');
    field.setAttribute('visibility', known ? 'visible' : 'hidden');
    if (!known) {
      readout.textContent = chosen || `no attitude at ${time.toFixed(2)} s`;
      return;
    }
    const boresight = rotate(sky.q[index], [0, 0, 1]);
    const place = project(boresight) || [-9, -9];
    here.setAttribute('cx', place[0]);
    here.setAttribute('cy', place[1]);
    if (sky.border.length) {
      field.setAttribute('d', polyline(sky.border.map((v) => rotate(sky.q[index], v)), project,
        +svg.getAttribute('width'), true));
    }
    const [ra, dec] = radec(boresight);
    readout.textContent = chosen || `boresight at ${sky.t[index].toFixed(2)} s: `
      + `RA ${shown(ra, 4)}\u00b0, Dec ${shown(dec, 4)}\u00b0`;
  };
  figures.push({draw, point: tell});
}

for (const panel of data.panels) {
  plotPanel(document.getElementById(panel.id), panel);
}
if (data.states.length) {
  plotStates(document.getElementById('states'), data.states, 'state of the tracker over time');
}
data.heads.forEach((head, index) => {
  plotStates(document.getElementById(`heads-${index}`), head.states,
    `state of ${head.name} over time`);
});
data.histograms.forEach((histogram, index) => {
  plotHistogram(document.getElementById(`histogram-${index}`), histogram);
});
if (data.sky) {
  plotSky(document.getElementById('sky'), data.sky);
}
for (const button of document.querySelectorAll('.frame')) {
  button.addEventListener('click', () => setCursor(Number(button.dataset.time)));
}
const marks = document.getElementById('marks');
if (marks) {
  marks.addEventListener('click', () => {
    const hidden = document.getElementById('frames').classList.toggle('no-marks');
    marks.setAttribute('aria-pressed', String(!hidden));
  });
}
document.getElementById('cursor').addEventListener('input',
  (event) => setCursor(Number(event.target.value)));
const zoom = (factor) => {
  const middle = view.cursor === null ? (view.from + view.to) / 2 : view.cursor;
  const from = middle - (middle - view.from) * factor;
  setView(from, from + (view.to - view.from) * factor);
};
document.getElementById('zoom-in').addEventListener('click', () => zoom(0.5));
document.getElementById('zoom-out').addEventListener('click', () => zoom(2));
document.getElementById('whole').addEventListener('click', () => setView(0, data.duration || 1));
document.getElementById('theme').addEventListener('click', () => {
  const style = document.documentElement.style;
  const dark = style.colorScheme ? style.colorScheme === 'dark'
    : matchMedia('(prefers-color-scheme: dark)').matches;
  style.colorScheme = dark ? 'light' : 'dark';
});
let width = 0;
new ResizeObserver(() => {
  if (document.body.clientWidth !== width) {
    width = document.body.clientWidth;
    figures.forEach((figure) => figure.draw());
  }
}).observe(document.body);
setView(0, data.duration || 1);
