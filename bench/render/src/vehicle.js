// Draws a quadrotor, its path and its reference in three dimensions on a canvas: z up, x forward, y left, metres.
//
// `vehicleView(canvas)` returns an object with these functions:
//   path(points), reference(points)   sets the lines, arrays of [x, y, z]
//   marks(list)                       sets the marked points: {position, color, label}
//   draw(pose)                        draws {position, attitude: [w, x, y, z], reference, rotors: four numbers 0 to 1}
// A drag or the arrow keys turn the view, the wheel, + and - zoom, 0 resets. Colours come from the page's style sheet.
// The vehicle is drawn larger than it is.
const vehicleView = (canvas) => {
  const START = { azimuth: -2.2, elevation: 0.5, zoom: 1 };
  // Rotors 1 to 4 as shares of the arm (docs/conventions.md).
  const ROTORS = [[-0.7, 0.7], [-0.7, -0.7], [0.7, -0.7], [0.7, 0.7]];
  const view = { ...START };
  const scene = { path: [], reference: [], marks: [], pose: null };
  const pen = canvas.getContext("2d");

  const color = (name) => getComputedStyle(canvas).getPropertyValue(`--${name}`).trim() || "gray";

  // The box around all lines; the camera looks at its middle.
  const box = () => {
    const points = [...scene.path, ...scene.reference, ...(scene.pose ? [scene.pose.position] : [])];
    const low = [0, 1, 2].map((i) => Math.min(...(points.length ? points.map((p) => p[i]) : [-1])));
    const high = [0, 1, 2].map((i) => Math.max(...(points.length ? points.map((p) => p[i]) : [1])));
    low[2] = Math.min(low[2], 0);
    const size = Math.max(1, Math.hypot(...[0, 1, 2].map((i) => high[i] - low[i])));
    return { low, high, middle: [0, 1, 2].map((i) => (low[i] + high[i]) / 2), size };
  };

  // A function from the world to pixels of the canvas, in perspective.
  const camera = ({ middle, size }) => {
    const [ca, sa] = [Math.cos(view.azimuth), Math.sin(view.azimuth)];
    const [ce, se] = [Math.cos(view.elevation), Math.sin(view.elevation)];
    const distance = 2.5 * size;
    const scale = 2 * view.zoom * Math.min(canvas.width, 1.4 * canvas.height);
    return ([x, y, z]) => {
      const [dx, dy, dz] = [x - middle[0], y - middle[1], z - middle[2]];
      const right = -sa * dx + ca * dy, forward = -ca * dx - sa * dy;
      const up = se * forward + ce * dz, depth = Math.max(0.05 * size, distance + ce * forward - se * dz);
      return [canvas.width / 2 + scale * right / depth, canvas.height / 2 - scale * up / depth];
    };
  };

  const line = (at, points, stroke, width, dash = []) => {
    if (points.length < 2) return;
    pen.beginPath();
    for (const point of points) pen.lineTo(...at(point));
    pen.strokeStyle = stroke;
    pen.lineWidth = width * devicePixelRatio;
    pen.setLineDash(dash.map((it) => it * devicePixelRatio));
    pen.stroke();
  };
  const dot = (at, point, fill, radius) => {
    pen.beginPath();
    pen.arc(...at(point), radius * devicePixelRatio, 0, 2 * Math.PI);
    pen.fillStyle = fill;
    pen.fill();
  };
  // Labels stand beside their points: inside the canvas, on a line free of other labels, and shortened to the width.
  let labels = [];
  const label = (at, point, text) => {
    const [x, y] = at(point), gap = 6 * devicePixelRatio, height = 14 * devicePixelRatio;
    pen.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
    pen.textAlign = "left";
    const widthOf = (it) => pen.measureText(it).width, most = canvas.width - 2 * gap;
    let shown = text;
    while (shown.length > 1 && widthOf(shown) > most) shown = `${shown.slice(0, -2).trimEnd()}\u2026`;
    const width = widthOf(shown), isRight = x + gap + width > canvas.width - gap;
    const left = Math.max(gap, isRight ? x - gap - width : x + gap);
    const isFree = (base) => base >= height && base <= canvas.height
      && labels.every((it) => it.left > left + width || it.right < left || Math.abs(it.base - base) >= height);
    // The nearest free line: above, below, two above, ...
    const lines = Array.from({ length: 40 }, (_, i) => y - gap + (i % 2 ? -1 : 1) * Math.ceil(i / 2) * height);
    const base = lines.find(isFree) ?? y - gap;
    labels.push({ left, right: left + width, base });
    pen.globalAlpha = 0.8;
    pen.fillStyle = color("card");
    pen.fillRect(left - gap / 3, base - 0.8 * height, width + 2 * gap / 3, height);
    pen.globalAlpha = 1;
    pen.fillStyle = color("ink");
    pen.fillText(shown, left, base);
  };

  // The ground, a square of the grid being 1, 2 or 5 times a power of ten of metres wide.
  const ground = (at, { low, high, size }) => {
    const rough = size / 8, decade = 10 ** Math.floor(Math.log10(rough));
    const step = decade * [1, 2, 5, 10].find((it) => it * decade >= rough);
    const [x0, y0] = [0, 1].map((i) => Math.floor(low[i] / step) - 1);
    const [x1, y1] = [0, 1].map((i) => Math.ceil(high[i] / step) + 1);
    for (let i = x0; i <= x1; i++) line(at, [[i * step, y0 * step, 0], [i * step, y1 * step, 0]], color("faint"), 1);
    for (let i = y0; i <= y1; i++) line(at, [[x0 * step, i * step, 0], [x1 * step, i * step, 0]], color("faint"), 1);
    const corner = [low[0], low[1], 0];
    for (const [name, end] of [["x", [step, 0, 0]], ["y", [0, step, 0]], ["z", [0, 0, step]]]) {
      const tip = corner.map((it, i) => it + end[i]);
      line(at, [corner, tip], color("muted"), 1.5);
      label(at, tip, name === "x" ? `x ${step} m` : name);
    }
  };

  const rotate = ([w, x, y, z], [a, b, c]) => {
    const [tx, ty, tz] = [2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)];
    return [a + w * tx + y * tz - z * ty, b + w * ty + z * tx - x * tz, c + w * tz + x * ty - y * tx];
  };
  const vehicle = (at, { position, attitude, rotors }, size) => {
    const arm = 0.07 * size / view.zoom ** 0.5;
    const body = (offset) => rotate(attitude, offset.map((it) => it * arm)).map((it, i) => it + position[i]);
    const foot = [position[0], position[1], 0];
    line(at, [position, foot], color("shade"), 1, [3, 3]);
    dot(at, foot, color("shade"), 3);
    for (const [x, y] of ROTORS) line(at, [position, body([x, y, 0])], color("ink"), 3);
    line(at, [position, body([1.1, 0, 0])], color("red"), 3);
    ROTORS.forEach(([x, y], i) => {
      const circle = Array.from({ length: 25 }, (_, k) => {
        const angle = 2 * Math.PI * k / 24;
        return body([x + 0.42 * Math.cos(angle), y + 0.42 * Math.sin(angle), 0.05]);
      });
      line(at, circle, color("ink"), 1);
      pen.globalAlpha = 0.1 + 0.7 * Math.min(1, Math.max(0, rotors[i]));
      pen.fillStyle = color(["sky", "orange", "purple", "green"][i]);
      pen.fill();
      pen.globalAlpha = 1;
    });
  };

  const render = () => {
    canvas.width = Math.max(1, canvas.clientWidth * devicePixelRatio);
    canvas.height = Math.max(1, canvas.clientHeight * devicePixelRatio);
    const around = box(), at = camera(around);
    labels = [];
    ground(at, around);
    line(at, scene.reference, color("shade"), 4);
    line(at, scene.path, color("blue"), 1.6);
    for (const mark of scene.marks) {
      dot(at, mark.position, color(mark.color), 5);
      label(at, mark.position, mark.label);
    }
    if (!scene.pose) return;
    if (scene.pose.reference) dot(at, scene.pose.reference, color("shade"), 5);
    vehicle(at, scene.pose, around.size);
  };
  // At most one drawing per frame of the display.
  let isPlanned = false;
  const plan = () => {
    if (isPlanned) return;
    isPlanned = true;
    requestAnimationFrame(() => {
      isPlanned = false;
      render();
    });
  };

  const turn = (across, up) => {
    view.azimuth -= across;
    view.elevation = Math.min(1.55, Math.max(-0.2, view.elevation + up));
    plan();
  };
  const zoom = (factor) => {
    view.zoom = Math.min(20, Math.max(0.3, view.zoom * factor));
    plan();
  };
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => event.buttons && turn(event.movementX / 150, event.movementY / 150));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 500));
  }, { passive: false });
  const keys = {
    ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0), ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1),
    "+": () => zoom(1.2), "-": () => zoom(1 / 1.2), 0: () => { Object.assign(view, START); plan(); },
  };
  canvas.tabIndex = 0;
  canvas.style.touchAction = "none";
  canvas.addEventListener("keydown", (event) => {
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  });
  new ResizeObserver(plan).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", plan);

  return {
    path: (points) => { scene.path = points; plan(); },
    reference: (points) => { scene.reference = points; plan(); },
    marks: (list) => { scene.marks = list; plan(); },
    draw: (pose) => { scene.pose = pose; plan(); },
  };
};
