// The explorable: a room from above and in section; cameras and objects are moved, shadows, AND, ghosts and the objects
// that explain the shadows follow. anywidget's format; where Python runs, model.get("answer") is what the library says.
// Metres, x to the right, y up; cells are numbered row by row from the least x and y.

// Strict JSON, which Python reads, too. Cameras: [name, x, y, height]; objects: [x, y, radius, height, cameras that miss it];
// from: the height before the cameras are raised; chosen: an object, or -1 - a camera.
export const presets = {
	"hide the small one": {
		"caption": "For camera A, object 2 stands in the shadow of object 1 and is lost in it; camera B sees them apart, and so does AND.",
		"cameras": [["A", -3.05, 0, 2.5], ["B", 3.05, 0, 2.5]],
		"objects": [[-0.4, 0.1, 0.25, 0.9], [0.7, 0.15, 0.12, 0.25]],
		"chosen": 0
	},
	"make a ghost": {
		"caption": "Where object 1's shadow from A crosses object 2's shadow from B, AND claims something though nothing stands there: a ghost.",
		"cameras": [["A", -3.05, 0, 2.5], ["B", 0, -2.45, 2.5]],
		"objects": [[-0.7, 0.35, 0.18, 1.1], [0.35, -0.75, 0.18, 1.1]],
		"chosen": 0
	},
	"a third camera": {
		"caption": "The third camera, C, looks at bare floor where the ghost was, and one view that sees bare floor is enough for AND.",
		"cameras": [["A", -3.05, 0, 2.5], ["B", 0, -2.45, 2.5], ["C", 3.05, 0, 2.5]],
		"objects": [[-0.7, 0.35, 0.18, 1.1], [0.35, -0.75, 0.18, 1.1]],
		"chosen": -3
	},
	"raise the cameras": {
		"caption": "From 1.6 m up to 3.2 m: the higher the lamps, the shorter the shadows, and the less is claimed beyond the true area.",
		"cameras": [["A", -3.05, 0, 3.2], ["B", 0, -2.45, 3.2]],
		"objects": [[-0.9, 0.55, 0.2, 0.8], [0.2, -0.55, 0.25, 0.6], [1.2, 0.5, 0.15, 0.7]],
		"from": 1.6,
		"chosen": -1
	},
	"one mask has a hole": {
		"caption": "Camera B's mask has a hole where object 2 should be: A still sees it, but AND needs every view, so the object is lost.",
		"cameras": [["A", -3.05, 0, 2.5], ["B", 3.05, 0, 2.5]],
		"objects": [[-0.6, -0.45, 0.25, 0.6], [0.5, 0.5, 0.2, 0.5, ["B"]]],
		"chosen": 1
	}
};

// The cameras and objects of a preset, all values named.
const scenes = (name) => ({
	cameras: presets[name].cameras.map(([name, x, y, height]) => ({ name, x, y, height, view: 150 })),
	objects: presets[name].objects.map(([x, y, radius, height, missed = []]) => ({ x, y, radius, height, missed })),
});

// --- geometry: as lab.shadow_mask, occlusion.fuse, find_regions and ghost_regions of the library
const LEAST_AREA = 0.004; // m2; a smaller region is noise
const NEW = 0.2; // share of an object's shadow in some view that no other may explain
const { PI, min, max, cos, sin, sqrt, atan2 } = Math;
const clamp = (value, low, high) => min(max(value, low), high);
const length = (x, y) => sqrt(x * x + y * y); // ten times as fast as Math.hypot

function grid({ x, y, resolution }) {
	const cells = ([low, high]) => max(1, Math.round((high - low) / resolution));
	return { nx: cells(x), ny: cells(y), x0: x[0], y0: y[0], r: resolution };
}

// Calls visit(i) for the cells in the shadow that a camera, as a lamp, makes an upright cylinder cast, its base included. The
// sight-line from a cell to the lamp is lower than the object for h / H of its length; if that part comes within the radius
// it is shadow. Of an object as high as the lamp the shadow is endless.
function cast(camera, { x, y, radius, height }, { nx, ny, x0, y0, r }, visit) {
	const part = min(1, height / camera.height), grow = part < 1 ? 1 / (1 - part) : Infinity;
	const range = (at, lamp, low, count) => {
		const top = grow < Infinity ? lamp + (at - lamp) * grow : 0, wide = grow < Infinity ? radius * grow : Infinity;
		return [max(0, Math.floor((min(at - radius, top - wide) - low) / r - 0.5)),
			min(count - 1, Math.ceil((max(at + radius, top + wide) - low) / r - 0.5))];
	};
	const [left, right] = range(x, camera.x, x0, nx), [bottom, above] = range(y, camera.y, y0, ny);
	for (let iy = bottom; iy <= above; iy++) {
		const py = y0 + (iy + 0.5) * r, qy = y - py, dy = (camera.y - py) * part;
		for (let ix = left; ix <= right; ix++) {
			const px = x0 + (ix + 0.5) * r, qx = x - px, dx = (camera.x - px) * part;
			const t = clamp((qx * dx + qy * dy) / (dx * dx + dy * dy || 1), 0, 1);
			if ((qx - t * dx) ** 2 + (qy - t * dy) ** 2 <= radius * radius) visit(iy * nx + ix);
		}
	}
}

// The cells within a camera's angle of view, from above and in degrees, around the floor's middle.
function seenBy(camera, floor, { nx, ny, x0, y0, r }) {
	const seen = new Uint8Array(nx * ny), { x, y, view } = camera;
	const mx = (floor.x[0] + floor.x[1]) / 2 - x, my = (floor.y[0] + floor.y[1]) / 2 - y;
	const least = view < 360 ? cos((view * PI) / 360) * length(mx, my) : -1e9;
	for (let iy = 0; iy < ny; iy++)
		for (let ix = 0; ix < nx; ix++) {
			const px = x0 + (ix + 0.5) * r - x, py = y0 + (iy + 0.5) * r - y;
			seen[iy * nx + ix] = px * mx + py * my >= least * length(px, py) ? 1 : 0;
		}
	return seen;
}

// Regions of at least `least` cells, 8-connected, in order.
function findRegions(mask, { nx, ny, x0, y0, r }, least) {
	const labels = new Int32Array(nx * ny), stack = new Int32Array(nx * ny), regions = [];
	for (let start = 0; start < mask.length; start++) {
		if (!mask[start] || labels[start]) continue;
		let count = 1, done = 0, sx = 0, sy = 0;
		stack[0] = start;
		labels[start] = regions.length + 1;
		while (done < count) {
			const i = stack[done++], ix = i % nx, iy = (i - ix) / nx;
			sx += ix;
			sy += iy;
			for (let jy = max(iy - 1, 0); jy <= min(iy + 1, ny - 1); jy++)
				for (let jx = max(ix - 1, 0); jx <= min(ix + 1, nx - 1); jx++) {
					const j = jy * nx + jx;
					if (mask[j] && !labels[j]) {
						labels[j] = regions.length + 1;
						stack[count++] = j;
					}
				}
		}
		if (count >= least) regions.push({ cells: count, x: x0 + (sx / count + 0.5) * r, y: y0 + (sy / count + 0.5) * r });
		else for (let k = 0; k < count; k++) labels[stack[k]] = -1;
	}
	return { labels, regions };
}

// Exact distance in cells from every cell to the nearest 0 of a mask: along the columns, then, row by row, the lower envelope
// of the parabolas on the columns (Felzenszwalb and Huttenlocher).
function distances(mask, nx, ny) {
	const far = nx + ny, result = new Float32Array(nx * ny);
	for (let i = 0; i < result.length; i++) result[i] = mask[i] ? (i < nx ? far : result[i - nx] + 1) : 0;
	for (let i = result.length - nx - 1; i >= 0; i--) if (result[i] > result[i + nx] + 1) result[i] = result[i + nx] + 1;
	const f = new Float64Array(nx), at = new Int32Array(nx), from = new Float64Array(nx + 1);
	for (let row = 0; row < result.length; row += nx) {
		let k = -1;
		for (let q = 0; q < nx; q++) {
			f[q] = result[row + q] ** 2 + q * q;
			let s = -Infinity;
			while (k >= 0 && (s = (f[q] - f[at[k]]) / (2 * (q - at[k]))) <= from[k]) k--;
			at[++k] = q;
			from[k] = k ? s : -Infinity;
		}
		from[k + 1] = Infinity;
		for (let q = 0, j = 0; q < nx; q++) {
			while (from[j + 1] < q) j++;
			const a = at[j];
			result[row + q] = mask[row + q] ? sqrt(q * q - 2 * q * a + f[a]) : 0;
		}
	}
	return result;
}

// The fewest cylinders that explain all shadows, a simple version of occlib.explaining. Candidates: the widest upright
// cylinders that fit into the AND map, as tall as their shadows stay within every view's. The one that explains most of what
// is still unexplained is taken, again and again, while a share NEW of its shadow in some view is new. A ghost lies where
// shadows of others cross: it explains nothing new.
function explain(cameras, g, shadows, seen, occupied) {
	const { nx, ny, x0, y0, r } = g, own = distances(occupied, nx, ny);
	const free = cameras.map((_, k) => distances(shadows[k].map((s, i) => s | (1 - seen[k][i])), nx, ny));
	// The far end of its shadow must lie in every view's; off the floor a view does not tell.
	const fits = (x, y, radius, height) => {
		let judged = false;
		for (let k = 0; k < cameras.length; k++) {
			const c = cameras[k], t = height / (c.height - height);
			if (t < 0 || t === Infinity) continue;
			const ix = Math.round((x + (x - c.x) * t - x0) / r - 0.5), iy = Math.round((y + (y - c.y) * t - y0) / r - 0.5);
			if (ix < 0 || iy < 0 || ix >= nx || iy >= ny) continue;
			if (free[k][iy * nx + ix] * r < radius * (1 + t) - 1.5 * r) return false;
			judged = true;
		}
		return judged;
	};
	const candidates = [], kept = [];
	for (let iy = 0; iy < ny; iy++)
		for (let ix = 0; ix < nx; ix++) {
			const i = iy * nx + ix, here = own[i], radius = (here - 0.5) * r;
			const ridge = (step) => here >= (own[i - step] || 0) && here >= (own[i + step] || 0);
			if (radius < 0.05 || !(ridge(1) || ridge(nx))) continue;
			const x = x0 + (ix + 0.5) * r, y = y0 + (iy + 0.5) * r;
			let height = 0;
			while (height < 2 && fits(x, y, radius, height + 0.04)) height += 0.04;
			if (height) candidates.push({ x, y, radius, height });
		}
	candidates.sort((a, b) => b.radius * b.height - a.radius * a.height);
	// The cells of each view that a candidate explains; grown, lest its rim be taken for another object.
	const cells = (c, grown) => cameras.map((camera, k) => {
		const list = [], height = c.height * (1 + 2 * grown) + grown / 2;
		cast(camera, { ...c, radius: c.radius + grown, height }, g, (i) => shadows[k][i] && list.push(i));
		return list;
	});
	for (const c of candidates)
		if (kept.length < 40 && kept.every((one) => length(one.x - c.x, one.y - c.y) > 0.7 * min(one.radius, c.radius) + r)) kept.push({ ...c, cells: cells(c, 0) });
	const left = shadows.map((shadow) => shadow.slice()), sum = (masks) => masks.reduce((total, mask) => mask.reduce((a, b) => a + b, total), 0);
	const gain = (c) => {
		let total = 0, share = 0;
		c.cells.forEach((list, k) => {
			let fresh = 0;
			for (const i of list) fresh += left[k][i];
			total += fresh;
			if (fresh * r * r >= 2 * LEAST_AREA) share = max(share, fresh / list.length);
		});
		return share < NEW ? 0 : total;
	};
	const explained = [];
	for (;;) {
		const best = kept.map((c) => [gain(c), c]).reduce((a, b) => (b[0] > a[0] ? b : a), [0]);
		if (!best[0]) return { explained, unexplained: sum(left) / (sum(shadows) || 1) };
		cells(best[1], 0.05).forEach((list, k) => list.forEach((i) => (left[k][i] = 0)));
		explained.push(best[1]);
	}
}

// All that is known of a scene.
function analyse({ cameras, objects, floor }) {
	const g = grid(floor), size = g.nx * g.ny, least = LEAST_AREA / (g.r * g.r), needed = min(2, cameras.length);
	const seen = cameras.map((camera) => seenBy(camera, floor, g));
	const shadows = cameras.map((camera, k) => {
		const mask = new Uint8Array(size);
		for (const each of objects)
			if (!each.missed.includes(camera.name)) cast(camera, each, g, (i) => (mask[i] = seen[k][i]));
		return mask;
	});
	const occupied = new Uint8Array(size), blind = new Uint8Array(size);
	let claimed = 0, unseen = 0;
	for (let i = 0; i < size; i++) {
		let views = 0, yes = 0;
		for (let k = 0; k < cameras.length; k++) {
			views += seen[k][i];
			yes += shadows[k][i];
		}
		claimed += occupied[i] = views >= needed && yes === views && views > 0 ? 1 : 0;
		unseen += blind[i] = views ? 0 : 1;
	}
	const { labels, regions } = findRegions(occupied, g, least), base = new Uint8Array(size);
	const lost = objects.map((each) => {
		let cells = 0, kept = 0;
		cast({ x: each.x, y: each.y, height: 1 }, { ...each, height: 0 }, g, (i) => {
			cells++;
			base[i] = 1;
			kept += occupied[i];
			if (labels[i] > 0) regions[labels[i] - 1].real = true;
		});
		return kept < cells / 2;
	});
	const truth = base.reduce((sum, one) => sum + one);
	return {
		...g, shadows, seen, occupied, blind, labels, regions, lost, unseen, claimed, truth,
		ghosts: regions.filter((region) => !region.real).length,
		alone: shadows.map((shadow) => findRegions(shadow, g, least).regions.length),
		ratio: truth ? claimed / truth : NaN,
		...explain(cameras, g, shadows, seen, occupied),
	};
}

export const geometry = { scenes, analyse };

// --- the page
const COLOURS = { A: "#0072B2", B: "#E69F00", C: "#009E73", D: "#CC79A7" }; // Okabe and Ito, as in occlib.plotting
const ROOM = 1.1; // m from the floor to the walls
const STEP = { x: 0.1, y: 0.1, radius: 0.02, height: 0.1, view: 10 }; // of a key
const LABEL = { x: "x (m)", y: "y (m)", radius: "radius (m)", height: "height (m)", view: "view (°)" };
const KEYS = { ArrowLeft: ["x", -1], ArrowRight: ["x", 1], ArrowDown: ["y", -1], ArrowUp: ["y", 1], PageUp: ["height", 1], PageDown: ["height", -1],
	"+": ["height", 1], "-": ["height", -1], "[": ["radius", -1], "{": ["radius", -1], "]": ["radius", 1], "}": ["radius", 1] };
const HELP = "Drag, or use keys: Enter chooses, arrows move, + and − change the height, [ and ] the radius; Shift makes small steps; Delete removes.";
const STYLE = `
.occ { --ink: #1b1f24; --soft: #575f69; --paper: #ffffff; --floor: #f1eee8; --line: #8a929c; --veil: .45; --accent: #0b57a4; --warn: #a63d00; --ghost: #d55e00;
	container-type: inline-size; color: var(--ink); background: var(--paper); font: 15px/1.45 system-ui, sans-serif; padding: 12px; max-width: 1180px; margin: 0 auto;
&[data-dark] { --ink: #eef1f4; --soft: #b3bcc6; --paper: #14181d; --floor: #2a3038; --line: #7b8794; --veil: .7; --accent: #8cc4ff; --warn: #ffa270 }
&, & * { box-sizing: border-box }
& p, & dd { margin: 0 } & h3 { font-size: 15px; margin: 14px 0 6px }
& .occ-row { display: flex; flex-wrap: wrap; gap: 8px; margin: 14px 0 }
& .occ-caption { min-height: 3em; margin: 0 0 14px; font-size: 17px }
& .occ-grid { display: grid; grid-template-columns: minmax(0, 3fr) minmax(0, 2fr); gap: 20px 28px; align-items: start }
& button, & input { font: inherit; color: inherit; background: var(--paper); border: 1px solid var(--line); border-radius: 6px; padding: 5px 9px; min-height: 34px; margin: 0 }
& button:disabled { opacity: .45 } & button[aria-pressed=true] { background: var(--ink); color: var(--paper) }
& input[type=checkbox] { width: 18px } & input[type=number] { width: 5.2em }
& label { display: grid; font-size: 13px; color: var(--soft) } & label > * { color: var(--ink); font-size: 15px }
& .occ-plan { position: relative } & canvas { width: 100%; image-rendering: pixelated } & .occ-plan canvas { position: absolute; height: 100%; max-width: none } & section canvas { background: var(--floor); transform: scaleY(-1) }
& svg { position: relative; display: block; width: 100%; height: auto; max-width: none; overflow: hidden }
& svg * { vector-effect: non-scaling-stroke }
& text { fill: var(--ink); font: 600 calc(13px * var(--u, 1)) system-ui, sans-serif; text-anchor: middle; pointer-events: none; user-select: none }
& .occ-halo { paint-order: stroke; stroke: var(--paper); stroke-width: 4px; fill: var(--warn) }
& .occ-item { cursor: grab; touch-action: none; outline: none }
& .occ-item[aria-pressed=true] .occ-ring { stroke: var(--ink); stroke-width: 1.5px } & .occ-item:focus .occ-ring { stroke: var(--accent); stroke-width: 3.5px }
& dl { display: grid; grid-template-columns: repeat(auto-fill, minmax(110px, 1fr)); gap: 12px; margin: 14px 0 } & dl div { border-top: 2px solid var(--line); padding-top: 5px }
& dt, & small, & .occ-small { font-size: 13px; line-height: 1.3; font-weight: 400; color: var(--soft) } & small { display: block }
& dt { display: flex; align-items: center; gap: 6px; width: auto } & :is(dt, dd, small) { float: none } & i { flex: none; width: 15px; height: 15px; border: 1px solid var(--line) } & dd { font-size: 21px; font-variant-numeric: tabular-nums }
& .occ-spoken { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%) }
@container (max-width: 760px) { & .occ-grid { grid-template-columns: minmax(0, 1fr) } } }`;
const [INK, SOFT, LINE, PAPER] = ["ink", "soft", "line", "paper"].map((name) => `var(--${name})`);

let made = 0; // for ids
const round = (value) => Math.round(value * 100) / 100;
const copy = (value) => JSON.parse(JSON.stringify(value));
const many = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;
const SVG = new Set("svg g circle rect path text".split(" "));

// Attributes of an element; functions listen to the event of their name.
function set(element, attributes) {
	for (const [name, value] of Object.entries(attributes))
		if (typeof value === "function") element.addEventListener(name, value);
		else element.setAttribute(name, value);
	return element;
}
function h(tag, attributes = {}, ...children) {
	const element = SVG.has(tag) ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
	element.append(...children);
	return set(element, attributes);
}

// The book's or JupyterLab's theme, else what the reader prefers.
function isDark({ documentElement, body } = document) {
	if (documentElement.dataset.theme) return documentElement.dataset.theme === "dark";
	if (body.dataset.jpThemeLight) return body.dataset.jpThemeLight === "false";
	return matchMedia("(prefers-color-scheme: dark)").matches;
}

// The hull of two discs, the base and the top's shadow; a far one ends an endless shadow.
function outline(path, camera, { x, y, radius, height }) {
	const t = height < camera.height ? min(height / (camera.height - height), 50) : 50, R = radius * (1 + t);
	const far = length(x - camera.x, y - camera.y) * t, way = atan2(y - camera.y, x - camera.x);
	const half = far > R - radius ? Math.acos((radius - R) / far) : PI;
	const tx = x + (x - camera.x) * t, ty = y + (y - camera.y) * t;
	path.moveTo(tx + R * cos(way - half), ty + R * sin(way - half));
	path.arc(tx, ty, R, way - half, way + half);
	if (half < PI) path.arc(x, y, radius, way + half, way - half + 2 * PI);
	path.closePath();
}

function render({ model, el }) {
	let cameras = copy(model.get("cameras")), objects = copy(model.get("objects")), preset = model.get("preset");
	const floor = model.get("floor"), middle = { x: (floor.x[0] + floor.x[1]) / 2, y: (floor.y[0] + floor.y[1]) / 2 };
	const id = `occ${++made}`;
	const scene = () => ({ cameras, objects, floor });
	const key = ({ cameras, objects }) => JSON.stringify([cameras, objects]);
	let chosen = presets[preset].chosen, lamp = 0, body = 0; // an object, or -1 - camera; and whom the section shows
	let found, before, moving, sending, speaking, sent = key(scene()), tone = {}, u = 1, v = 1; // u, v: units of a px
	let marks = {}, inputs = {}, fieldsOf;

	// --- what may be done
	const itemOf = (which) => (which < 0 ? cameras[-1 - which] : objects[which]);
	const nameOf = (which) => (which < 0 ? `camera ${itemOf(which).name}` : `object ${which + 1}`);
	const all = () => [...cameras.map((_, k) => -1 - k), ...objects.keys()];
	const aim = (camera) => atan2(middle.y - camera.y, middle.x - camera.x);
	function limits(item) {
		const wall = item.view ? ROOM : 0, within = ([low, high]) => [low - wall, high + wall];
		return { x: within(floor.x), y: within(floor.y), radius: [0.08, 0.5], height: wall ? [0.5, 4] : [0.05, 2], view: [30, 360] };
	}
	function describe(which) {
		const item = itemOf(which), numbers = Object.keys(LABEL).filter((name) => name in item).map((name) => `${name} ${item[name]}`);
		return `${nameOf(which)}: ${numbers.join(", ")}${item.missed?.length ? `, missed by ${item.missed.join(" and ")}` : ""}`;
	}
	function choose(which) {
		chosen = itemOf(which) ? which : objects.length ? 0 : -1;
		if (chosen < 0) lamp = -1 - chosen;
		else body = chosen;
		lamp = min(lamp, cameras.length - 1);
		body = min(body, objects.length - 1);
	}
	function change(which, name, value) {
		const item = itemOf(which);
		if (!(name in item) || !Number.isFinite(value)) return;
		item[name] = clamp(round(value), ...limits(item)[name]);
		stop(which);
	}
	function stop(which) {
		cancelAnimationFrame(moving);
		before = null;
		choose(which);
	}
	function later() {
		clearTimeout(sending);
		sending = setTimeout(send, 250);
	}
	function send() {
		clearTimeout(sending);
		sent = key(scene());
		for (const [name, value] of Object.entries({ cameras, objects, preset })) model.set(name, copy(value));
		model.save_changes();
	}
	function draw() {
		found = analyse(scene());
		paint();
		clearTimeout(speaking);
		speaking = setTimeout(() => (spoken.textContent = `${describe(chosen)}. ${many(objects.length, "object")}, ${many(found.regions.length, "region")}, ${
			many(found.ghosts, "ghost")}, ${found.explained.length} explained, ${lost()} lost; claimed ${ratio()} times the true area.`), 500);
	}
	const lost = () => found.lost.filter(Boolean).length, ratio = () => (found.truth ? found.ratio.toFixed(2) : "–");
	function edited(which) {
		stop(which);
		build();
		later();
	}
	const lowered = (height) => cameras.map((camera) => ({ ...camera, height }));
	const ratioFrom = (height) => height && analyse({ cameras: lowered(height), objects, floor }).ratio;
	function start(name) {
		const { from, chosen: first } = presets[name], began = performance.now();
		preset = name;
		({ cameras, objects } = scenes(name));
		lamp = body = 0;
		edited(first);
		before = ratioFrom(from);
		const goal = cameras, rise = (now) => {
			const t = matchMedia("(prefers-reduced-motion: reduce)").matches ? 1 : clamp((now - began - 400) / 1600, 0, 1);
			cameras = goal.map((camera) => ({ ...camera, height: round(from + (camera.height - from) * t * t * (3 - 2 * t)) }));
			draw();
			if (t < 1) moving = requestAnimationFrame(rise);
			else later();
		};
		if (from) rise(began);
	}
	function press(event, which, upright) {
		const [axis, way] = KEYS[event.key] || [], name = upright && "xy".includes(axis) ? "height" : axis;
		if (event.ctrlKey || event.metaKey || event.altKey) return;
		if (!name && !/^(Delete|Enter| )$/.test(event.key)) return;
		if (event.key === "Delete") remove(which);
		else {
			if (name) change(which, name, itemOf(which)[name] + way * (event.shiftKey && event.key !== "+" ? 0.01 : STEP[name]));
			else choose(which);
			draw();
			later();
		}
		event.preventDefault();
		event.stopPropagation();
	}
	function drag(event, which, move, px) {
		if (event.button) return;
		const first = event, target = event.currentTarget, item = { ...itemOf(which) };
		target.setPointerCapture(event.pointerId);
		target.onpointermove = (e) => {
			move(which, item, ((e.clientX - first.clientX) * px) / 100, ((first.clientY - e.clientY) * px) / 100);
			draw();
		};
		target.onlostpointercapture = () => {
			target.onpointermove = null;
			send();
		};
		target.focus();
		choose(which);
		draw();
		event.preventDefault();
	}
	function remove(which) {
		if (which < 0 ? cameras.length <= 2 : !objects.length) return;
		const [{ name }] = which < 0 ? cameras.splice(-1 - which, 1) : objects.splice(which, 1);
		for (const each of objects) each.missed = each.missed.filter((one) => one !== name);
		edited(which < 0 ? -1 : max(which - 1, 0));
		marks[chosen].focus();
	}
	function addCamera() { // in the middle of the emptiest wall
		const { x, y } = limits({ view: 1 }), far = (wall) => min(...cameras.map((c) => length(c.x - wall.x, c.y - wall.y)));
		const [wall] = [...x.map((x) => ({ ...middle, x })), ...y.map((y) => ({ ...middle, y }))].sort((a, b) => far(b) - far(a));
		const name = [..."ABCD"].find((one) => cameras.every((c) => c.name !== one));
		cameras = [...cameras, { name, ...wall, height: 2.5, view: 150 }].sort((a, b) => (a.name < b.name ? -1 : 1));
		edited(-1 - cameras.findIndex((c) => c.name === name));
	}
	function addObject() { // on a spiral around the middle, where there is room
		let x, y, k = 0;
		do [x, y] = [round(middle.x + 0.15 * sqrt(k) * cos(2.4 * k)), round(middle.y + 0.12 * sqrt(k) * sin(2.4 * k))];
		while (k++ < 99 && objects.some((one) => length(one.x - x, one.y - y) < one.radius + 0.3));
		edited(objects.push({ x, y, radius: 0.18, height: 0.4, missed: [] }) - 1);
	}

	// --- the parts of the page; drawings are in cm
	const left = (floor.x[0] - ROOM) * 100, above = (-floor.y[1] - ROOM) * 100, wide = 100 * (floor.x[1] - floor.x[0] + 2 * ROOM), tall = 100 * (floor.y[1] - floor.y[0] + 2 * ROOM);
	const button = (text, click) => h("button", { type: "button", click }, text), RIM = 22, reach = length(wide, tall) * 0.9;
	const picture = h("canvas", { "aria-hidden": true }), cells = h("canvas"), answerPicture = h("canvas", { "aria-hidden": true });
	const small = () => h("p", { class: "occ-small" }), app = (label, box) => h("svg", { viewBox: box.join(" "), role: "application", "aria-label": label, "aria-describedby": id });
	const plan = app("The room from above", [left - RIM, above - RIM, wide + 2 * RIM, tall + 2 * RIM]), section = app("The room in section", [-30, -430, reach + 60, 490]);
	const caption = h("p", { class: "occ-caption" }), spoken = h("p", { class: "occ-spoken", role: "status", "aria-live": "polite" });
	const stories = h("div", { class: "occ-row", role: "group", "aria-label": "Stories", style: "margin-top: 0" }, ...Object.keys(presets).map((name) => button(name, () => start(name))));
	const read = h("dl");
	const sectionTitle = h("h3"), picked = h("h3"), fields = h("div", { class: "occ-row" }), note = small(), answerText = small();
	const answerBox = h("section", {}, h("h3", {}, "occlib’s map, from Python"), answerPicture, answerText);
	const more = button("Add camera", addCamera), another = button("Add object", addObject), fewer = button("Remove", () => remove(chosen));
	const root = h("div", { class: "occ", "data-lm-suppress-shortcuts": true, role: "group", "aria-label": "Explorable room" }, h("style", {}, STYLE), stories, caption,
		h("div", { class: "occ-grid" },
			h("div", {}, h("h3", {}, "From above"), h("div", { class: "occ-plan" }, picture, plan), read),
			h("div", {}, sectionTitle, section, note, picked, fields, h("div", { class: "occ-row" }, another, more, fewer,
				button("Reset", () => start(preset))), h("p", { class: "occ-small occ-row", id }, HELP), answerBox)), spoken);
	el.replaceChildren(root);

	// What can be moved; `which` tells whose it is now.
	function handle(svg, which, move, attributes, ...shape) {
		return h("g", { class: "occ-item", tabindex: 0, keydown: (e) => press(e, which(), svg === section), pointerdown: (e) => drag(e, which(), move, svg === plan ? u : v),
			...attributes }, h("circle", { fill: "transparent" }), h("circle", { class: "occ-ring", fill: "none" }), ...shape);
	}
	const letter = (camera) => h("text", { dy: ".35em", style: `fill: ${camera.name === "A" ? "#fff" : "#000"}` }, camera.name);
	const rise = (which, item, dx, dy) => change(which, "height", item.height + dy);
	const upright = { role: "slider", "aria-orientation": "vertical", style: "cursor: ns-resize" };
	const lampTop = handle(section, () => -1 - lamp, rise, upright, h("circle", { stroke: INK }), letter(cameras[0])), bodyTop = handle(section, () => body, rise, upright, h("circle", { fill: INK }));
	const dashed = (tag, dashes, stroke) => h(tag, { fill: "none", stroke, "stroke-dasharray": dashes, "stroke-width": 1.5 });
	const scenery = h("g"), view = dashed("path", "6 5", SOFT), line = dashed("path", "1 4", SOFT), explained = dashed("g", "5 4", "var(--accent)"), notes = h("g");
	section.append(scenery, lampTop, bodyTop);

	// What depends on their numbers.
	function build() {
		for (const one of stories.children) set(one, { "aria-pressed": one.textContent === preset });
		caption.textContent = presets[preset].caption;
		const move = (which, item, dx, dy) => (change(which, "x", item.x + dx), change(which, "y", item.y + dy));
		marks = {};
		for (const which of all()) {
			const item = itemOf(which);
			marks[which] = handle(plan, () => which, move, { role: "button" }, ...(which < 0 ? [h("path", { d: "M-1 0A1 1 0 0 1 0-1H.8L1.45 0 .8 1H0A1 1 0 0 1-1 0Z", fill: COLOURS[item.name], stroke: INK }), letter(item)]
				: [h("circle", { fill: PAPER, "fill-opacity": 0.8, stroke: INK, "stroke-width": 1.5 }), h("text", { dy: ".35em" }, which + 1)]));
		}
		const box = (x, y, width, height, stroke) => h("rect", { x, y, width, height, fill: "none", stroke: LINE, "stroke-width": stroke });
		plan.replaceChildren(box(left, above, wide, tall, 3), box(floor.x[0] * 100, -floor.y[1] * 100, wide - 200 * ROOM, tall - 200 * ROOM, 1), view, line, explained, ...all().map((which) => marks[which]), notes);
		more.disabled = cameras.length >= 4;
		another.disabled = objects.length >= 8;
		fieldsOf = null;
		sizes();
	}
	function buildFields() {
		const item = itemOf(chosen), which = (fieldsOf = chosen);
		inputs = {};
		const field = (name, text, attributes) => h("label", {}, text, (inputs[name] = h("input", attributes)));
		const done = () => (draw(), later());
		fields.replaceChildren(...Object.keys(LABEL).filter((name) => name in item).map((name) => {
			const [low, high] = limits(item)[name].map(round);
			const take = ({ type, target }) => {
				const value = parseFloat(target.value);
				if (type === "change" || (value >= low && value <= high)) change(which, name, value);
				done();
				if (type === "change") target.value = item[name];
			};
			return field(name, LABEL[name], { type: "number", min: low, max: high, step: name === "view" ? 1 : 0.01, input: take, change: take });
		}), ...(item.missed ? cameras : []).map(({ name }) => field(name, `missed by ${name}`, { type: "checkbox", change: ({ target }) => {
			item.missed = [...item.missed.filter((one) => one !== name), ...(target.checked ? [name] : [])].sort();
			done();
		} })));
	}

	// --- painting
	function place(mark, x, y, r, px, label) {
		const [hit, ring] = mark.children;
		set(mark, { transform: `translate(${x} ${y})`, "aria-label": label });
		set(hit, { r: max(r, 14 * px) });
		set(ring, { r: r + 4 * px });
	}
	function paint() {
		for (const which of all()) {
			const item = itemOf(which), mark = marks[which], r = item.radius ? item.radius * 100 : 13 * u;
			place(mark, item.x * 100, -item.y * 100, r, u, describe(which));
			set(mark, { "aria-pressed": which === chosen });
			set(mark.children[2], item.radius ? { r } : { transform: `rotate(${(-aim(item) * 180) / PI}) scale(${r})` });
		}
		explained.replaceChildren(...found.explained.map(({ x, y, radius }) => h("circle", { cx: x * 100, cy: -y * 100, r: radius * 100 + 8 * u })));
		const sign = (text, x, y) => h("text", { class: "occ-halo", x: x * 100, y: -y * 100 - 7 * u }, text);
		notes.replaceChildren(...found.regions.filter((region) => !region.real).map(({ x, y, cells }) => sign("ghost", x, y + 0.6 * found.r * sqrt(cells))), ...objects.filter((_, i) => found.lost[i]).map((o) => sign("lost", o.x, o.y + o.radius)));
		const camera = cameras[lamp], half = (camera.view * PI) / 360, ray = (a) => `M${camera.x * 100} ${-camera.y * 100}l${cos(a) * 900} ${-sin(a) * 900}`;
		set(view, { d: chosen < 0 && camera.view < 360 ? ray(aim(camera) - half) + ray(aim(camera) + half) : "" });
		paintFloor();
		paintSection(camera, objects[body]);
		const stripes = (a, b) => `repeating-linear-gradient(135deg, var(--${a}) 0 3px, var(--${b}) 3px 6px)`, percent = (part) => `${(100 * part).toFixed(0)} %`;
		const rows = [...cameras.map(({ name }, k) => [name, `Regions from ${name}`, found.alone[k], "", `color-mix(in srgb, ${COLOURS[name]} calc(var(--veil) * 100%), var(--floor))`]),
			["and", "Regions in AND", found.regions.length, "", INK], ["ghosts", "Ghosts", found.ghosts, "", stripes("ghost", "ink")], ["objects", "Objects", objects.length, "", "var(--paper); border-radius: 9px"],
			["explained", "Explained", found.explained.length, found.unexplained > 0.02 && `${percent(found.unexplained)} of shadows unexplained`, "none; border: 2px dashed var(--accent); border-radius: 9px"],
			["lost", "Lost in AND", lost()], ["ratio", "Claimed / true", ratio(), before && `was ${before.toFixed(2)}`], ["blind", "Seen by none", percent(found.unseen / found.labels.length), "", stripes("line", "floor")]];
		read.replaceChildren(...rows.map(([name, term, value, more, background]) => h("div", {}, h("dt", {}, background ? h("i", { style: `background: ${background}` }) : "", term),
			h("dd", { "data-read": name }, value, more ? h("small", {}, more) : ""))));
		if (fieldsOf !== chosen) buildFields();
		picked.textContent = `Chosen: ${nameOf(chosen)}`;
		const item = itemOf(chosen);
		for (const [name, input] of Object.entries(inputs))
			if (input.type === "checkbox") input.checked = item.missed.includes(name);
			else if (input !== document.activeElement) input.value = item[name];
		fewer.disabled = chosen < 0 && cameras.length <= 2;
		paintAnswer();
	}
	function paintCells(canvas, colour) { // row 0 on top: upside down
		const { nx, ny } = found, brush = canvas.getContext("2d");
		Object.assign(canvas, { width: nx, height: ny });
		const image = brush.createImageData(nx, ny);
		new Uint32Array(image.data.buffer).forEach((_, i, bytes) => (bytes[i] = colour(i)));
		brush.putImageData(image, 0, 0);
	}
	// Shadows as exact outlines, on them the map's cells.
	function paintFloor() {
		const { nx, ny, r } = found, context = picture.getContext("2d"), sharp = min(2, devicePixelRatio || 1), scale = (100 * sharp) / u;
		Object.assign(picture, { width: (sharp * (wide + 2 * RIM)) / u, height: (sharp * (tall + 2 * RIM)) / u });
		context.setTransform(scale, 0, 0, -scale, (scale * (RIM - left)) / 100, (scale * (RIM - above)) / 100);
		context.beginPath();
		context.rect(left / 100, -(above + tall) / 100, wide / 100, tall / 100);
		context.clip();
		context.fillStyle = tone.floor;
		context.fill();
		for (const camera of cameras) {
			const path = new Path2D(), wedge = new Path2D(), half = (camera.view * PI) / 360;
			for (const each of objects) if (!each.missed.includes(camera.name)) outline(path, camera, each);
			wedge.moveTo(camera.x, camera.y);
			wedge.arc(camera.x, camera.y, 99, aim(camera) - half, aim(camera) + half);
			context.save();
			context.clip(wedge);
			context.globalAlpha = tone.veil * (chosen >= 0 || itemOf(chosen) === camera ? 1 : 0.45);
			context.fillStyle = COLOURS[camera.name];
			context.fill(path);
			context.restore();
		}
		paintCells(cells, (i) => {
			const label = found.labels[i], stripe = (((i % nx) + Math.floor(i / nx)) * r) % 0.12 < 0.06;
			if (label) return label < 0 ? tone.faint : stripe && !found.regions[label - 1].real ? tone.ghost : tone.ink;
			return found.blind[i] && stripe ? tone.line : 0;
		});
		context.globalAlpha = 1;
		context.imageSmoothingEnabled = false;
		context.drawImage(cells, floor.x[0], floor.y[0], nx * r, ny * r);
	}
	// The upright plane through a camera and an object.
	function paintSection(camera, object) {
		const H = camera.height * 100, parts = [];
		const block = (from, to, height, fill, stroke, text) => parts.push(h("rect", { x: from, y: -height, width: to - from, height, fill, stroke }), h("text", { x: (from + to) / 2, y: 20 * v }, text));
		sectionTitle.textContent = `In section: camera ${camera.name}${object ? ` and object ${body + 1}` : ""}`;
		for (let z = 0; z < 500; z += 100) parts.push(h("path", { d: `M-30 ${-z}H${reach + 30}`, stroke: LINE, opacity: z ? 0.4 : 1 }), h("text", { x: reach + 28 - 14 * v, y: -z - 4 * v }, `${z / 100} m`));
		parts.push(h("path", { d: `M0 0V${-H}`, stroke: LINE }));
		note.textContent = "";
		if (object) {
			const dx = object.x - camera.x, dy = object.y - camera.y, d = length(dx, dy) || 1e-6, top = object.height * 100, from = (d - object.radius) * 100, edge = (d + object.radius) * 100;
			const end = (edge * H) / max(H - top, 1), number = (cm) => (cm / 100).toFixed(2);
			for (const each of objects) {
				const ex = each.x - camera.x, ey = each.y - camera.y, along = (ex * dx + ey * dy) / d, half = sqrt(each.radius ** 2 - ((ey * dx - ex * dy) / d) ** 2);
				if (each !== object && half > 0) block((along - half) * 100, (along + half) * 100, each.height * 100, "var(--floor)", SOFT, objects.indexOf(each) + 1);
			}
			parts.push(h("path", { d: `M${from} ${-top}H${edge}L${end} 0H${from}Z`, fill: COLOURS[camera.name], opacity: 0.22 }), h("path", { d: `M${from} 4H${end}`, stroke: COLOURS[camera.name], "stroke-width": 7 }));
			block(from, edge, top, PAPER, INK, body + 1);
			parts.push(h("path", { d: `M0 ${-H}L${end} 0`, stroke: INK }));
			note.textContent = top >= H ? "The object is as high as the lamp: its shadow is endless."
				: `Beyond the object the shadow reaches d·h / (H − h) = ${number(edge)} · ${number(top)} / (${number(H)} − ${number(top)}) = ${number(end - edge)} m.`;
		}
		set(line, { d: object ? `M${camera.x * 100} ${-camera.y * 100}L${object.x * 100} ${-object.y * 100}` : "" });
		scenery.replaceChildren(...parts);
		const put = (mark, which, x, r) => {
			const { height } = itemOf(which), [low, high] = limits(itemOf(which)).height;
			place(mark, x, -height * 100, r, v, `Height of ${nameOf(which)} in metres`);
			set(mark, { "aria-valuemin": low, "aria-valuemax": high, "aria-valuenow": height });
		};
		put(lampTop, -1 - lamp, 0, 12 * v);
		set(lampTop.children[2], { r: 12 * v, fill: COLOURS[camera.name] });
		lampTop.lastChild.replaceWith(letter(camera));
		set(bodyTop, { visibility: object ? "visible" : "hidden" });
		if (object) put(bodyTop, body, length(object.x - camera.x, object.y - camera.y) * 100, 5 * v);
		set(bodyTop.children[2], { r: 5 * v });
	}
	// What Python said: its map as runs of free and occupied cells by turns.
	function paintAnswer() {
		const answer = model.get("answer"), { nx, ny } = found;
		answerBox.hidden = !answer?.runs;
		if (answerBox.hidden) return;
		const fresh = key(answer) === key(scene());
		answerPicture.style.opacity = fresh ? 1 : 0.4;
		if (!fresh) return void (answerText.textContent = "Python is at work …");
		const claims = answer.runs.flatMap((count, k) => new Array(count).fill(k % 2));
		let same = 0;
		paintCells(answerPicture, (i) => {
			if (claims[i] !== found.occupied[i]) return tone.ghost;
			same++;
			return claims[i] ? tone.ink : 0;
		});
		answerText.textContent = `${many(answer.regions, "region")}, ${many(answer.ghosts, "ghost")}, claimed / true ${answer.ratio?.toFixed(2) ?? "–"}; ${
			answer.explained ? `the Explainer finds ${many(answer.explained.length, "object")}; ` : ""}same as the browser’s in ${((100 * same) / (nx * ny)).toFixed(1)} % of the cells.`;
	}

	function sizes() {
		u = (wide + 2 * RIM) / (plan.clientWidth || 640);
		v = (reach + 60) / (section.clientWidth || 400);
		plan.style.setProperty("--u", u);
		section.style.setProperty("--u", v);
		theme(); // needs the page
		draw();
	}
	function theme() {
		root.toggleAttribute("data-dark", isDark());
		const style = getComputedStyle(root), value = (name) => style.getPropertyValue(`--${name}`).trim();
		const bytes = (name, alpha) => parseInt(alpha + value(name).slice(1).replace(/(..)(..)(..)/, "$3$2$1"), 16); // of a picture
		tone = { floor: value("floor"), veil: value("veil"), ink: bytes("ink", "eb"), faint: bytes("ink", "70"), ghost: bytes("ghost", "eb"), line: bytes("line", "c8") };
		if (found) paint();
	}
	function told() { // Python moved something
		const next = copy({ cameras: model.get("cameras"), objects: model.get("objects") });
		if ([key(scene()), sent].includes(key(next))) return;
		({ cameras, objects } = next);
		[sent, preset, before] = [key(next), model.get("preset"), null];
		choose(chosen);
		build();
	}
	const resized = new ResizeObserver(sizes), themed = new MutationObserver(theme), prefers = matchMedia("(prefers-color-scheme: dark)");
	choose(chosen);
	if (key(scene()) === key(scenes(preset))) before = ratioFrom(presets[preset].from);
	build();
	resized.observe(plan);
	for (const one of [document.documentElement, document.body]) themed.observe(one, { attributeFilter: ["data-theme", "data-jp-theme-light"] });
	prefers.addEventListener("change", theme);
	const heard = [["change:cameras", told], ["change:objects", told], ["change:answer", paintAnswer]];
	for (const pair of heard) model.on(...pair);
	return () => {
		clearTimeout(sending);
		clearTimeout(speaking);
		cancelAnimationFrame(moving);
		resized.disconnect();
		themed.disconnect();
		prefers.removeEventListener("change", theme);
		for (const pair of heard) model.off(...pair);
	};
}

export default { render };
