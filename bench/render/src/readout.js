// Shows the values of a chart where the pointer is: read off its lines, so as precise as these are drawn.
(() => {
  const inverse = {
    linear: (share, low, high) => low + share * (high - low),
    log: (share, low, high) => low * (high / low) ** share,
    symmetric: (share, low, high, threshold) => {
      const bent = (value) => Math.sign(value) * Math.log1p(Math.abs(value) / threshold);
      const value = bent(low) + share * (bent(high) - bent(low));
      return Math.sign(value) * threshold * Math.expm1(Math.abs(value));
    },
    tail: (share, low, high) => -Math.expm1(share * Math.log1p(-high)),
  };
  const axis = (words) => {
    const [kind, ...numbers] = words.split(" ");
    return (share) => inverse[kind](share, ...numbers.map(Number));
  };
  const short = (value, isCount) => String(isCount && value < 100 ? Math.round(value) : Number(value.toPrecision(3)));
  // Points of a path as [x, y], one list for each of its parts.
  const parts = (path) => path.getAttribute("d").split("M").slice(1).map((part) => part.split("L").map((pair) => pair.split(" ").map(Number)));

  // Smallest and largest height of a line around x; of a histogram, the height of the bin at x.
  const heights = (path, x) => {
    const found = [], isSteps = path.classList.contains("steps"), reach = isSteps ? 0 : 1;
    for (const points of parts(path)) {
      points.forEach(([x0, y0], i) => {
        if (!isSteps && Math.abs(x0 - x) <= reach) found.push(y0);
        const [x1, y1] = points[i + 1] || [x0, y0];
        if (x0 < x && x <= x1) found.push(y0 + (y1 - y0) * (x - x0) / (x1 - x0));
      });
    }
    return found.length ? [Math.max(...found), Math.min(...found)] : null;
  };

  const name = (figure, path) => {
    const key = [...figure.querySelectorAll("figcaption .key")].find((it) => path.classList.contains(it.classList[1]));
    return key ? key.textContent : "";
  };
  const unit = (label) => (label.match(/\[(.*)\]/) || ["", ""])[1];

  const lines = (figure, svg, [left, right, top, foot], x) => {
    const [atX, atY] = [axis(svg.dataset.x), axis(svg.dataset.y)];
    const [labelX, labelY] = [".of-x", ".of-y"].map((it) => svg.querySelector(it).textContent);
    const where = atX((x - left) / (right - left));
    const all = [`${labelX.replace(/ \[.*/, "")} ${svg.dataset.x.startsWith("tail") ? `${Number((100 * where).toPrecision(5))} %` : `${short(where)} ${unit(labelX)}`}`];
    for (const path of svg.querySelectorAll("path.line, path.steps")) {
      const seen = heights(path, x);
      if (!seen) continue;
      const [low, high] = seen.map((y) => short(atY((foot - y) / (foot - top)), labelY === "count"));
      all.push(`${name(figure, path)} ${low === high ? low : `${low} to ${high}`} ${unit(labelY)}`.trim());
    }
    for (const mark of svg.querySelectorAll("path.vertical")) {
      if (Math.abs(Number(mark.getAttribute("d").slice(1).split(" ")[0]) - x) < 2 && getComputedStyle(mark).display !== "none")
        all.push(mark.querySelector("title").textContent);
    }
    return all;
  };

  for (const svg of document.querySelectorAll("svg[data-frame]")) {
    const figure = svg.closest("figure"), frame = svg.dataset.frame.split(" ").map(Number);
    const [left, right, top, foot] = frame;
    let box = null, cursor = null;
    const leave = () => {
      if (box) [box, cursor].forEach((it) => it.remove());
      box = cursor = null;
    };
    svg.addEventListener("pointerleave", leave);
    svg.addEventListener("pointermove", (event) => {
      const room = svg.getBoundingClientRect(), scale = svg.viewBox.baseVal.width / room.width;
      const x = (event.clientX - room.left) * scale;
      if (x < left || x > right) return leave();
      if (!box) {
        box = figure.appendChild(document.createElement("div"));
        box.className = "readout";
        cursor = svg.appendChild(document.createElementNS(svg.namespaceURI, "line"));
        cursor.setAttribute("class", "cursor");
      }
      for (const [key, value] of Object.entries({ x1: x, x2: x, y1: top, y2: foot })) cursor.setAttribute(key, value);
      box.replaceChildren(...lines(figure, svg, frame, x).map((words) => {
        const line = document.createElement("div");
        line.textContent = words;
        return line;
      }));
      // On the side where there is more room.
      const across = event.clientX - figure.getBoundingClientRect().left, isLeft = x < (left + right) / 2;
      const beyond = isLeft ? across : figure.clientWidth - across;
      box.style.left = isLeft ? `${beyond + 14}px` : "";
      box.style.right = isLeft ? "" : `${beyond + 14}px`;
      box.style.maxWidth = `${figure.clientWidth - beyond - 20}px`;
      box.style.top = `${room.top - figure.getBoundingClientRect().top + top / scale}px`;
    });
  }
})();
