// Wipes: two pictures of a frame and the divider between them.
for (const figure of document.querySelectorAll("figure.wipe")) {
  const find = (selector) => figure.querySelector(selector);
  const content = JSON.parse(find("script").textContent);
  const stage = find(".stage"), divider = find(".divider"), range = find("input");
  const sides = ["left", "right"];
  const images = { left: find("img.left"), right: find("img.right") };
  const tags = { left: find(".tag.left"), right: find(".tag.right") };
  const selects = { left: find("select.left"), right: find("select.right") };
  const buttons = [...figure.querySelectorAll(".buttons button")];
  const key = find(".buttons")?.dataset.switch;
  const pixels = new Map(); // address of a map -> its pixels, read when first pointed at
  let place = 50;

  const chosen = (side) => content.sides[selects[side].value];
  const view = () => content.views[range.value];

  const divide = (percent) => {
    place = Math.min(100, Math.max(0, percent));
    images.left.style.clipPath = `inset(0 ${100 - place}% 0 0)`;
    divider.style.left = `${place}%`;
    divider.setAttribute("aria-valuenow", Math.round(place));
  };

  const tag = (side, reading) => {
    const layer = view().layers[selects[side].value];
    const said = reading ?? (layer ? layer[1] : "no picture of this frame");
    const name = document.createElement("b");
    name.textContent = chosen(side).name;
    tags[side].replaceChildren(name, said ? ` ${said}` : "");
    tags[side].classList.toggle("reading", reading !== undefined);
  };

  const draw = () => {
    for (const side of sides) {
      const layer = view().layers[selects[side].value];
      images[side].hidden = !layer;
      if (layer && images[side].src !== layer[0]) images[side].src = layer[0];
      images[side].alt = `${chosen(side).name}, frame ${view().id}`;
      tag(side);
    }
    find("output").textContent = `${view().id} (${Number(range.value) + 1} of ${content.views.length})`;
    range.setAttribute("aria-valuetext", `frame ${view().id}`);
    const kinds = sides.map((side) => chosen(side).kind);
    for (const legend of figure.querySelectorAll(".legend")) legend.hidden = !kinds.includes(legend.dataset.kind);
    for (const button of buttons) {
      const on = sides.some((side) => chosen(side)[key] === button.dataset.choice);
      button.setAttribute("aria-pressed", on);
    }
  };

  // A button changes the source, or the kind, of both sides; a side without such a picture stays as it is.
  const press = (choice) => {
    const own = content.sides[0].source;
    for (const side of sides) {
      const now = chosen(side);
      if (key === "source" && now.source === own) continue;
      const wanted = { ...now, [key]: choice };
      const found = content.sides.findIndex((each) => each.source === wanted.source && each.kind === wanted.kind);
      if (found >= 0) selects[side].value = found;
    }
    if (key === "source" && !sides.some((side) => chosen(side).source === choice))
      selects.right.value = content.sides.findIndex((each) => each.source === choice);
    draw();
  };

  const pixelsOf = (image) => {
    if (!pixels.has(image.src)) {
      const canvas = document.createElement("canvas");
      canvas.width = image.naturalWidth;
      canvas.height = image.naturalHeight;
      const context = canvas.getContext("2d");
      context.drawImage(image, 0, 0);
      pixels.set(image.src, context.getImageData(0, 0, canvas.width, canvas.height));
    }
    return pixels.get(image.src);
  };

  // What the colour under the pointer means, in words; nothing for a photograph.
  const read = (side, x, y) => {
    const meanings = content.readings[chosen(side).kind], image = images[side];
    if (!meanings || image.hidden || !image.naturalWidth) return undefined;
    const { data, width, height } = pixelsOf(image);
    const column = Math.min(width - 1, Math.floor(x * width)), row = Math.min(height - 1, Math.floor(y * height));
    const rgb = data.subarray(4 * (row * width + column), 4 * (row * width + column) + 3);
    return meanings[[...rgb].map((channel) => channel.toString(16).padStart(2, "0")).join("")];
  };

  const share = (event) => {
    const box = stage.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  };

  stage.addEventListener("pointerdown", (event) => {
    stage.setPointerCapture(event.pointerId);
    divide(100 * share(event)[0]);
    divider.focus({ preventScroll: true });
    event.preventDefault();
  });
  stage.addEventListener("pointermove", (event) => {
    const [x, y] = share(event);
    if (stage.hasPointerCapture(event.pointerId)) divide(100 * x);
    if (x >= 0 && x < 1 && y >= 0 && y < 1) sides.forEach((side) => tag(side, read(side, x, y)));
  });
  stage.addEventListener("pointerleave", () => sides.forEach((side) => tag(side)));
  divider.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -2, ArrowDown: -2, ArrowRight: 2, ArrowUp: 2, PageDown: -10, PageUp: 10, Home: -100, End: 100 };
    if (!(event.key in step)) return;
    divide(place + step[event.key]);
    event.preventDefault();
  });
  range.addEventListener("input", draw);
  sides.forEach((side) => selects[side].addEventListener("change", draw));
  buttons.forEach((button) => button.addEventListener("click", () => press(button.dataset.choice)));
  divide(place);
  draw();
}
