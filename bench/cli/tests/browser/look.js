// Looks for text that is cut, overlaps, or cannot be read; gives what it finds and what it has seen.
(() => {
  const faults = [], width = document.documentElement.clientWidth, slack = 1;
  document.querySelectorAll("details").forEach((details) => { details.open = true; });
  const words = (node) => JSON.stringify(node.textContent.trim().slice(0, 40));
  if (document.documentElement.scrollWidth > width) faults.push(`the page is ${document.documentElement.scrollWidth} wide`);

  // Every piece of text is inside the page and inside what cuts it.
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  let texts = 0;
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    if (!node.textContent.trim() || node.parentElement.closest("title, style, script")) continue;
    const range = document.createRange();
    range.selectNodeContents(node);
    for (const box of range.getClientRects()) {
      texts += 1;
      // The contents scroll where they are wider than the page, and so do the charts of a section on a phone.
      if (!node.parentElement.closest("nav, .plots") && (box.left < -slack || box.right > width + slack)) faults.push(`${words(node)} leaves the page`);
      const card = node.parentElement.closest("figure, .tiles div, td, th");
      const room = card && card.getBoundingClientRect();
      if (room && (box.left < room.left - slack || box.right > room.right + slack)) faults.push(`${words(node)} leaves its box`);
    }
  }

  // Text in a picture is inside it, of a size to be read, and alone.
  for (const svg of document.querySelectorAll("svg[role=img]")) {
    const name = svg.getAttribute("aria-label"), room = svg.getBoundingClientRect();
    const boxes = [...svg.querySelectorAll("text")].map((text) => [text, text.getBoundingClientRect()]);
    for (const [text, box] of boxes) {
      if (box.left < room.left - slack || box.right > room.right + slack || box.top < room.top - slack || box.bottom > room.bottom + slack)
        faults.push(`${words(text)} is cut in ${name}`);
      const size = parseFloat(getComputedStyle(text).fontSize) * room.width / svg.viewBox.baseVal.width;
      if (size < 8.5) faults.push(`${words(text)} is ${size.toFixed(1)} pixels high in ${name}`);
    }
    boxes.forEach(([one, a], i) => boxes.slice(i + 1).forEach(([other, b]) => {
      const across = Math.min(a.right, b.right) - Math.max(a.left, b.left);
      const down = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
      // Boxes of text are higher than what is written in them.
      if (across > 0 && down > 4) faults.push(`${words(one)} overlaps ${words(other)} in ${name}`);
    }));
    for (const line of svg.querySelectorAll("path.line, path.stem, path.steps")) {
      if (!line.getAttribute("d")) faults.push(`a line of ${name} is empty`);
    }
  }

  // Text has a contrast of 4.5 to its ground, lines have 3, except the reference, which is wide.
  const parse = (colour) => (colour.match(/[\d.]+/g) || [0, 0, 0]).map(Number);
  const luminance = (colour) => {
    const [r, g, b] = parse(colour).slice(0, 3).map((v) => (v / 255 <= 0.04045 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ground = (element) => {
    for (let e = element; e; e = e.parentElement) {
      const colour = getComputedStyle(e).backgroundColor;
      if (parse(colour)[3] !== 0) return colour;
    }
    return "rgb(255, 255, 255)";
  };
  const contrast = (a, b) => {
    const [dark, bright] = [luminance(a), luminance(b)].sort((x, y) => x - y);
    return (bright + 0.05) / (dark + 0.05);
  };
  const demand = (element, colour, least) => {
    const found = contrast(colour, ground(element));
    if (found < least) faults.push(`contrast ${found.toFixed(2)} of ${element.outerHTML.slice(0, 60)}`);
  };
  document.querySelectorAll("svg text").forEach((text) => demand(text, getComputedStyle(text).fill, 4.5));
  document.querySelectorAll("h1, h2, h3, p, dt, dd, th, td, b, a, span, summary, small").forEach((e) => {
    if (e.textContent.trim()) demand(e, getComputedStyle(e).color, 4.5);
  });
  document.querySelectorAll("svg path.line:not(.reference), svg path.stem, svg path.steps, svg .mark, svg .work, svg .cross, svg .late-stage").forEach((line) => demand(line, getComputedStyle(line).stroke, 3));
  document.querySelectorAll("svg rect.bar, svg rect.work:not(.stale)").forEach((bar) => demand(bar, getComputedStyle(bar).fill, 3));

  // The contents stay in sight, in one row.
  const nav = document.querySelector("nav"), isShown = nav && getComputedStyle(nav).display !== "none";
  if (isShown) {
    window.scrollTo(0, document.body.scrollHeight / 2);
    const { top, height } = nav.getBoundingClientRect();
    if (Math.abs(top) > slack || height > 60) faults.push(`the contents stand at ${top}, ${height} high`);
    for (const link of nav.querySelectorAll("a")) {
      if (!document.querySelector(link.getAttribute("href"))) faults.push(`nothing is at ${link.getAttribute("href")}`);
    }
    window.scrollTo(0, 0);
  }

  return {
    faults: [...new Set(faults)],
    texts,
    plots: [...document.querySelectorAll("[data-plot]")].filter((plot) => plot.querySelector("svg")).map((plot) => plot.dataset.plot),
    ground: getComputedStyle(document.body).backgroundColor,
    scripts: document.scripts.length,
  };
})()
