{
  const data = JSON.parse(document.getElementById("motions-data").textContent);
  const [stage, scenes, play, scrub, clock, speed] = ["stage", "scene", "play", "scrub", "clock", "speed"].map((id) =>
    document.getElementById(id),
  );
  const WIDTH = 320, HEIGHT = 250, COLUMNS = 5;
  let scene, views, frame = 0, playing = false, before = 0;

  const floats = (text) => new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  function choose(number) {
    const chosen = data.scenes[number];
    scene = { ...chosen, reference: floats(chosen.reference) };
    stage.replaceChildren();
    views = chosen.methods.map((method) => {
      const figure = document.createElement("figure");
      const caption = document.createElement("figcaption");
      const canvas = document.createElement("canvas");
      caption.textContent = method.name;
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", `Motion of the arm with ${method.name}; errors and torques are in the pictures below`);
      figure.append(caption, canvas);
      stage.append(figure);
      return { canvas, tint: `--c${method.colour}`, frames: floats(method.frames) };
    });
    scrub.max = scene.reference.length - 1;
    seek(0);
  }

  function seek(next) {
    frame = Math.min(Math.max(next, 0), scene.reference.length - 1);
    const shown = Math.floor(frame);
    scrub.value = shown;
    clock.value = `${((shown + 1) * data.period).toFixed(3)} s`;
    scrub.setAttribute("aria-valuetext", clock.value);
    for (const view of views) draw(view, shown);
  }

  function draw(view, now) {
    const ratio = devicePixelRatio || 1;
    const width = view.canvas.clientWidth || WIDTH, scale = width / WIDTH;
    const [w, h] = [Math.round(width * ratio), Math.round(HEIGHT * scale * ratio)];
    if (view.canvas.width !== w || view.canvas.height !== h) [view.canvas.width, view.canvas.height] = [w, h];
    const pen = view.canvas.getContext("2d");
    pen.setTransform(scale * ratio, 0, 0, scale * ratio, 0, 0);
    pen.clearRect(0, 0, WIDTH, HEIGHT);
    pen.lineCap = pen.lineJoin = "round";
    pen.font = "11px system-ui, sans-serif";
    const at = now * COLUMNS, ink = colour(view.tint), [joint, torsion] = view.frames.subarray(at, at + 2);
    machine(pen, scene.reference[now], joint, torsion, ink);
    magnifier(pen, view.frames, now, ink);
    strip(pen, view.frames, now, ink);
    pen.fillStyle = colour("--muted");
    pen.textAlign = "left";
    const error = Math.hypot(view.frames[at + 2], view.frames[at + 3]);
    pen.fillText(`error ${error.toFixed(1)} mm`, 8, 16);
    pen.fillText(`torque ${view.frames[at + 4].toFixed(2)} N m`, 8, 30);
  }

  // Link 1 to l (cos, sin)(theta_1); link 2 and hand end on the line from the shoulder in the direction theta_s.
  function posture(joint, torsion) {
    const pixels = 460, left = 26, ground = 164, { link, hand } = scene;
    const reach = 2 * link * Math.cos(joint - torsion);
    const point = (r, angle) => [left + pixels * r * Math.cos(angle), ground - pixels * r * Math.sin(angle)];
    return [point(0, 0), point(link, joint), point(reach, torsion), point(reach + hand, torsion)];
  }

  // As `beltarm_env/rendering/renderer.py` draws it, but link 1 and link 2 in the colour of the method.
  function machine(pen, reference, joint, torsion, ink) {
    const aim = posture(reference, 0), arm = posture(joint, torsion), [dark, ground, grey] = ["--ink", "--ground", "--muted"].map(colour);
    pen.fillStyle = colour("--rule");
    pen.fillRect(arm[0][0] - 10, arm[0][1], 20, 17);
    pen.fillRect(8, arm[0][1] - 0.5, WIDTH - 16, 1);
    belt(pen, arm, dark, ground);
    links(pen, aim, Array(3).fill(grey), 1.2);
    links(pen, aim, Array(3).fill(colour("--ghost")), 0);
    links(pen, arm, [ink, `color-mix(in srgb, ${ink} 55%, ${ground})`, dark], 0);
    for (const joint of arm.slice(0, 3)) disc(pen, joint, 3, dark), disc(pen, joint, 1.4, ground);
    if (scene.payload > 0) disc(pen, arm[2], 5.2, dark), disc(pen, arm[2], 4, colour("--rule"));
    pen.beginPath();
    pen.arc(...aim[3], 4.6, 0, 7);
    pen.strokeStyle = grey;
    pen.lineWidth = 1.4;
    pen.stroke();
    disc(pen, arm[3], 2.6, dark);
  }

  function links(pen, points, inks, rim) {
    [4, 2.9, 2].forEach((half, k) => {
      pen.strokeStyle = inks[k];
      pen.lineWidth = 2 * (half + rim);
      pen.beginPath();
      pen.moveTo(...points[k]), pen.lineTo(...points[k + 1]);
      pen.stroke();
    });
  }

  // From the pulley at the motor to the smaller one at joint 2.
  function belt(pen, [from, to], ink, ground) {
    const across = Math.atan2(to[1] - from[1], to[0] - from[0]) + Math.PI / 2;
    pen.beginPath();
    pen.arc(...from, 9.2, across, across + Math.PI);
    pen.arc(...to, 5.5, across + Math.PI, across + 2 * Math.PI);
    pen.closePath();
    pen.fillStyle = ground;
    pen.fill();
    pen.strokeStyle = ink;
    pen.lineWidth = 1;
    pen.stroke();
  }

  function disc(pen, place, radius, ink) {
    pen.beginPath();
    pen.arc(...place, radius, 0, 7);
    pen.fillStyle = ink;
    pen.fill();
  }

  function magnifier(pen, frames, now, ink) {
    const side = 84, x0 = WIDTH - side - 8, y0 = 20, middle = [x0 + side / 2, y0 + side / 2];
    const pixels = side / 2 / scene.magnified;
    pen.save();
    pen.beginPath();
    pen.rect(x0, y0, side, side);
    pen.fillStyle = colour("--ground");
    pen.fill();
    pen.strokeStyle = colour("--muted");
    pen.lineWidth = 1;
    pen.stroke();
    pen.clip();
    pen.beginPath();
    pen.moveTo(x0, middle[1]), pen.lineTo(x0 + side, middle[1]);
    pen.moveTo(middle[0], y0), pen.lineTo(middle[0], y0 + side);
    pen.strokeStyle = colour("--rule");
    pen.stroke();
    const place = (k) => [middle[0] + pixels * frames[k * COLUMNS + 2], middle[1] - pixels * frames[k * COLUMNS + 3]];
    pen.beginPath();
    for (let k = Math.max(0, now - 60); k <= now; k++) pen.lineTo(...place(k));
    pen.strokeStyle = ink;
    pen.lineWidth = 1.5;
    pen.stroke();
    pen.beginPath();
    pen.arc(...place(now), 3.5, 0, 7);
    pen.fillStyle = ink;
    pen.fill();
    pen.restore();
    pen.fillStyle = colour("--muted");
    pen.textAlign = "right";
    pen.fillText(`tip ±${scene.magnified} mm`, x0 + side, 14);
  }

  function strip(pen, frames, now, ink) {
    const left = 8, width = WIDTH - 16, top = 188, height = 56, count = scene.reference.length;
    const x = (k) => left + (width * (k + 1)) / count;
    const y = (k) => {
      const size = Math.hypot(frames[k * COLUMNS + 2], frames[k * COLUMNS + 3]) / scene.magnified;
      return top + height * (1 - Math.min(size, 1));
    };
    pen.fillStyle = colour("--shade");
    pen.fillRect(left, top, (width * scene.duration) / (count * data.period), height);
    pen.strokeStyle = colour("--rule");
    pen.lineWidth = 1;
    pen.strokeRect(left, top, width, height);
    pen.beginPath();
    for (let k = 0; k <= now; k++) pen.lineTo(x(k), y(k));
    pen.strokeStyle = ink;
    pen.lineWidth = 1.5;
    pen.stroke();
    pen.fillStyle = colour("--muted");
    pen.textAlign = "right";
    pen.fillText(`${scene.magnified} mm`, left + width - 3, top + 11);
  }

  function toggle(on) {
    playing = on;
    play.textContent = on ? "Pause" : "Play";
    if (!on) return;
    if (frame >= scene.reference.length - 1) seek(0);
    before = performance.now();
    requestAnimationFrame(step);
  }

  function step(time) {
    if (!playing) return;
    seek(frame + (Math.max(0, time - before) / 1000 / data.period) * speed.value);
    before = time;
    if (frame >= scene.reference.length - 1) toggle(false);
    else requestAnimationFrame(step);
  }

  play.addEventListener("click", () => toggle(!playing));
  scrub.addEventListener("input", () => (toggle(false), seek(Number(scrub.value))));
  scenes.addEventListener("change", () => choose(Number(scenes.value)));
  addEventListener("resize", () => seek(frame));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => seek(frame));
  choose(0);
}
