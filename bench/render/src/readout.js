// Shows the values of a chart where the pointer is, read off its lines, so as precise as these are drawn. A drag across a
// chart over time zooms all of them to that time, a double click shows the whole flight again. Links open folds.
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

  // The part of the flight that charts over time show, as shares of their axis.
  let shown = [0, 1];
  const isOverTime = (svg) => svg.dataset.x.startsWith("linear 0 ") && svg.querySelector(".of-x").textContent === "time [s]";
  // Between the pixels where a point is drawn and those where it is without zoom.
  const toWhole = (svg, left, right, x) => {
    const [from, to] = isOverTime(svg) ? shown : [0, 1];
    return left + (from + (x - left) / (right - left) * (to - from)) * (right - left);
  };
  const zoom = (from, to) => {
    shown = [from, to];
    for (const svg of document.querySelectorAll("svg[data-frame]")) {
      if (!isOverTime(svg)) continue;
      const [left, right] = svg.dataset.frame.split(" ").map(Number), factor = 1 / (to - from);
      const layers = svg.querySelector(".layers");
      layers.setAttribute("overflow", factor > 1 ? "hidden" : "visible");
      layers.firstChild.setAttribute("transform", `translate(${left - (left + from * (right - left)) * factor} 0) scale(${factor} 1)`);
      const [, , end] = svg.dataset.x.split(" ").map(Number), length = (to - from) * end;
      const decade = 10 ** Math.floor(Math.log10(length / 4)), step = decade * [1, 2, 5, 10].find((it) => it * decade >= length / 6);
      const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
      svg.querySelectorAll(".of-time").forEach((it) => it.remove());
      const line = svg.querySelector(".grid line.at-x"), text = svg.querySelector(".grid text.below");
      svg.querySelectorAll(".at-x, .below").forEach((it) => { it.style.display = factor > 1 ? "none" : ""; });
      for (let i = Math.ceil(from * end / step); factor > 1 && i * step <= to * end; i++) {
        const x = left + (i * step / end - from) * factor * (right - left);
        const [mark, label] = [line, text].map((it) => svg.querySelector(".grid").appendChild(it.cloneNode(true)));
        for (const it of [mark, label]) {
          it.classList.add("of-time");
          it.style.display = "";
        }
        mark.setAttribute("x1", x);
        mark.setAttribute("x2", x);
        label.setAttribute("x", x);
        label.textContent = (i * step).toFixed(decimals);
      }
    }
  };

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
    let box = null, cursor = null, dragged = null;
    const place = (event) => (event.clientX - svg.getBoundingClientRect().left) * svg.viewBox.baseVal.width / svg.getBoundingClientRect().width;
    const share = (x) => Math.min(1, Math.max(0, (toWhole(svg, left, right, x) - left) / (right - left)));
    svg.addEventListener("pointerdown", (event) => {
      if (!isOverTime(svg) || event.pointerType === "touch") return;
      event.preventDefault();
      dragged = place(event);
    });
    svg.addEventListener("pointerup", (event) => {
      const x = place(event);
      if (dragged !== null && Math.abs(x - dragged) > 4) zoom(...[share(dragged), share(x)].sort((a, b) => a - b));
      dragged = null;
    });
    svg.addEventListener("dblclick", () => zoom(0, 1));
    const leave = () => {
      if (box) [box, cursor].forEach((it) => it.remove());
      box = cursor = null;
    };
    svg.addEventListener("pointerleave", leave);
    svg.addEventListener("pointermove", (event) => {
      const room = svg.getBoundingClientRect(), scale = svg.viewBox.baseVal.width / room.width;
      const x = place(event);
      if (x < left || x > right) return leave();
      if (!box) {
        box = figure.appendChild(document.createElement("div"));
        box.className = "readout";
        cursor = svg.appendChild(document.createElementNS(svg.namespaceURI, "rect"));
        cursor.setAttribute("class", "cursor");
      }
      const ends = [dragged ?? x, x].sort((a, b) => a - b);
      for (const [key, value] of Object.entries({ x: ends[0], y: top, width: ends[1] - ends[0], height: foot - top })) cursor.setAttribute(key, value);
      box.replaceChildren(...lines(figure, svg, frame, toWhole(svg, left, right, x)).map((words) => {
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
  addEventListener("hashchange", () => {
    const fold = document.getElementById(location.hash.slice(1))?.querySelector("details");
    if (fold) fold.open = true;
  });
})();
