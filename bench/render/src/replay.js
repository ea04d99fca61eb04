// Moves the vehicle of a page's overview along its flight, from the JSON that the page holds.
for (const figure of document.querySelectorAll("figure.replay")) {
  const { columns, frames, marks } = JSON.parse(figure.querySelector(".flight").textContent);
  const at = Object.fromEntries(columns.map((name, i) => [name, i]));
  const pick = (frame, names) => names.map((name) => frame[at[name]]);
  const position = (frame) => pick(frame, ["x_w_m", "y_w_m", "z_w_m"]);
  const reference = (frame) => pick(frame, ["x_reference_w_m", "y_reference_w_m", "z_reference_w_m"]);
  const rotors = (frame) => pick(frame, [1, 2, 3, 4].map((i) => `rotor_${i}_rad_s`));
  const fastest = Math.max(1, ...frames.flatMap(rotors));
  // Roll, pitch and yaw (rotation about z, then y, then x) as a quaternion.
  const attitude = (frame) => {
    const [[cr, sr], [cp, sp], [cy, sy]] = pick(frame, ["roll_rad", "pitch_rad", "yaw_rad"]).map((it) => [Math.cos(it / 2), Math.sin(it / 2)]);
    return [cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy];
  };
  const [button, slider, output] = ["button", "input", "output"].map((it) => figure.querySelector(it));
  if (!frames.length) {
    figure.querySelector(".controls").remove();
    continue;
  }
  const begin = frames[0][0], end = frames[frames.length - 1][0];
  const frameAt = (time) => frames.findLastIndex((frame) => frame[0] <= time);
  const view = vehicleView(figure.querySelector("canvas"));
  view.reference(frames.map(reference));
  const inFlight = marks.filter(([time]) => time >= begin && time <= end);
  view.marks(inFlight.map(([time, label]) => ({ position: position(frames[frameAt(time)]), color: "red", label })));

  const show = (time) => {
    const i = Math.max(0, frameAt(time)), frame = frames[i];
    view.path(frames.slice(0, i + 1).map(position));
    view.draw({ position: position(frame), attitude: attitude(frame), reference: reference(frame), rotors: rotors(frame).map((it) => it / fastest) });
    slider.value = time;
    output.textContent = `${time.toFixed(2)} s`;
  };
  Object.assign(slider, { min: begin, max: end });
  let clock = null;
  const stop = () => {
    clock = null;
    button.textContent = "Play";
  };
  const step = (now) => {
    if (clock === null) return;
    const time = Math.min(end, Number(slider.value) + (now - clock) / 1e3);
    clock = now;
    show(time);
    if (time < end) requestAnimationFrame(step);
    else stop();
  };
  button.addEventListener("click", () => {
    if (clock !== null) return stop();
    if (Number(slider.value) >= end) show(begin);
    clock = performance.now();
    button.textContent = "Pause";
    requestAnimationFrame(step);
  });
  slider.addEventListener("input", () => {
    stop();
    show(Number(slider.value));
  });
  show(end);
}
