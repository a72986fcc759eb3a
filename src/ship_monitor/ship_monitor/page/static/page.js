// Writes the server's texts into the first screen. The script evaluates only the link: it is lost if no texts
// arrive. Times of arrival are by a clock that never steps.
"use strict";
const monitor = (() => {
  const limits = { linkLostMs: 1600, reloadAfterMs: 4000, lookMs: 200, busyMs: 10000 }, PHONE = "(max-width:699px)";
  const at = (id) => document.getElementById(id);
  let receivedMs = performance.now(), lookedMs = receivedMs, last = null, linked = false, lost = false, checking = false, marked = sessionStorage.getItem("marked") || "";

  function text(element, value) {
    if (element.textContent !== value) element.textContent = value;
  }
  function icon(svg, name) {
    const use = svg.firstElementChild, target = name ? "#" + name : "";
    if (use.getAttribute("href") !== target) use.setAttribute("href", target);
  }
  function element(tag, parent, className) {
    const made = document.createElement(tag);
    if (className) made.className = className;
    return parent.appendChild(made);
  }
  function drawing(parent, name) {
    const svg = parent.appendChild(document.createElementNS("http://www.w3.org/2000/svg", "svg"));
    svg.appendChild(document.createElementNS("http://www.w3.org/2000/svg", "use"));
    icon(svg, name);
    return svg;
  }
  // As many children as entries; existing children are reused.
  function list(parent, entries, make, fill) {
    while (parent.children.length > entries.length) parent.lastElementChild.remove();
    entries.forEach((entry, index) => fill(parent.children[index] || make(parent), entry));
  }

  function tile(id, angle) {
    const tile = at(id), part = (name) => tile.querySelector(name);
    tile.hidden = !angle;
    if (!angle) return;
    const hasDegree = angle.number.endsWith("°");
    tile.dataset.safety = angle.safety;
    tile.classList.toggle("old", angle.is_old);
    tile.classList.toggle("none", !hasDegree);
    text(part(".sense"), angle.sense);
    text(part(".digits"), hasDegree ? angle.number.slice(0, -1) : angle.number);
    text(part(".degree"), hasDegree ? "°" : "");
    text(part(".size"), angle.accuracy);
    part(".track i").style.width = (angle.bar === null ? 0 : 100 * angle.bar) + "%";
    text(part(".reason"), angle.reason);
    part(".reason").classList.toggle("why", angle.is_reason);
    text(part(".state b"), angle.safety);
    icon(part(".state svg"), angle.safety);
    tile.tip = angle.tip;
  }

  // Safety of the suite in the bar; below it the safety of each angle while the tiles are scrolled away.
  function states(model) {
    const overall = at("overall");
    chip(overall.firstElementChild, model.overall.safety);
    text(overall.querySelector("b"), model.overall.safety);
    text(overall.lastElementChild, model.overall.text);
    overall.title = model.overall.text;
    for (const each of at("states").children) {
      const angle = model.angles[each.dataset.angle];
      each.hidden = !angle;
      if (!angle) continue;
      chip(each, angle.safety);
      text(each.querySelector(".word"), angle.safety);
      text(each.querySelector(".size"), angle.accuracy);
    }
  }
  function chip(element, safety) {
    element.dataset.safety = safety;
    icon(element.firstElementChild, safety);
  }
  const watchScroll = () => {
    const isPast = at("tiles").firstElementChild.getBoundingClientRect().bottom < at("bar").offsetHeight;
    document.body.classList.toggle("scrolled", isPast);
  };
  addEventListener("scroll", watchScroll, { passive: true });

  function alertLine(alert) {
    at("alert").classList.toggle("calm", !alert.state);
    at("icon").className = alert.icon + " " + alert.state;
    at("icon").hidden = !alert.icon;
    icon(document.querySelector("#icon .shape"), alert.icon);
    icon(document.querySelector("#icon .sign"), alert.state);
    text(at("alert-text"), alert.text);
    at("alert-text").classList.toggle("long", alert.text.length > 32);
    // The line shows the advice instead of the time; the list shows advice and time.
    text(at("alert-sub"), alert.advice || alert.sub);
    at("alert-sub").classList.toggle("advice", Boolean(alert.advice));
    at("unack-count").hidden = !alert.unack;
    at("unack-count").className = alert.icon;
    text(at("unack-count"), alert.unack + " UNACK");
    list(at("alerts"), alert.all, (parent) => {
      const line = element("p", parent);
      element("span", line);
      element("small", line);
      element("div", line, "advice");
      return line;
    }, (line, entry) => [entry.text, entry.sub, entry.advice].forEach((value, index) => text(line.children[index], value)));
    if (!alert.all.length) at("alerts").hidden = true;
  }

  function ages(rows, foot) {
    list(document.querySelector("#ages dl"), rows.flatMap(([name, age]) => [name, age]), (parent) =>
      element(parent.children.length % 2 ? "dd" : "dt", parent), text);
    text(at("foot"), foot);
  }

  function sources(sources) {
    at("head").hidden = sources.out.length > 0;
    text(at("head"), sources.head);
    at("outs").className = sources.out.length > 1 ? "several" : "";
    list(at("outs"), sources.out, (parent) => {
      const bar = element("b", parent);
      drawing(bar, "UNSAFE");
      element("span", bar);
      bar.onclick = () => toggle(bar.title);
      return bar;
    }, (bar, [name, words]) => { bar.title = name; text(bar.children[1], words); bar.className = words.length > 20 ? "long" : ""; });
    text(at("why"), sources.why.join("\n"));
    list(document.querySelector("#sources ul"), sources.rows, (parent) => {
      const row = element("li", parent);
      drawing(row, "");
      for (const name of ["who", "presence", "age"]) element("span", row, name);
      element("small", row);
      row.onclick = () => toggle(row.children[1].textContent);
      return row;
    }, (row, source) => {
      row.className = source.presence + (source.is_because ? " because" : "") + (source.name === marked ? " marked" : "");
      icon(row.children[0], { IN: sources.is_known ? "SAFE" : "unknown", OUT: "UNSAFE" }[source.presence] || "");
      [source.name, source.presence, source.age, source.sub].forEach((value, index) => text(row.children[index + 1], value));
    });
    fit(sources.rows);
  }
  // OUT comes first in the list. Without enough room, second lines are removed first; then sources are only counted.
  function fit(rows) {
    const parent = document.querySelector("#sources ul"), items = [...parent.children];
    items.forEach((item) => { item.hidden = false; });
    at("more").hidden = true;
    if (matchMedia(PHONE).matches) return;
    const isFull = () => parent.scrollHeight > parent.clientHeight;
    parent.classList.remove("tight");
    parent.classList.toggle("tight", isFull());
    let shown = items.length;
    while (shown > 0 && isFull()) {
      at("more").hidden = false;
      items[--shown].hidden = true;
      const left = rows.slice(shown), out = left.filter((row) => row.presence === "OUT").length;
      text(at("more"), out ? `${left.length} more, ${out} OUT` : `${left.length} more in`);
    }
  }

  function ribbons(ribbons) {
    const span = (parent, className) => element("i", parent, className);
    document.querySelectorAll("#rows .row").forEach((row, index) => {
      row.hidden = index >= ribbons.rows.length;
      list(row.lastElementChild, ribbons.rows[index] || [], (parent) => span(parent), (part, [start, end, word]) => {
        const left = Math.max(0, start);
        part.className = word;
        part.style.left = 100 * left + "%";
        part.style.width = 100 * Math.max(0, Math.min(1, end) - left) + "%";
      });
    });
    list(at("ticks"), ribbons.ticks.flat(), (parent) => element(parent.children.length % 2 ? "span" : "i", parent),
      (part, value) => {
        if (part.tagName === "SPAN") { text(part, value); part.style.left = part.previousElementSibling.style.left; part.className = parseFloat(part.style.left) > 97 ? "last" : ""; }
        else part.style.left = 100 * value + "%";
      });
    list(at("marks"), ribbons.marks, span, (part, place) => { part.style.left = 100 * place + "%"; });
  }

  function draw(model) {
    text(at("utc"), model.utc);
    text(at("local"), model.local);
    document.documentElement.classList.toggle("stale", model.is_stale);
    document.body.classList.toggle("ship-alone", !model.angles.azimuth);
    text(at("label"), model.label);
    at("paused").hidden = !model.is_paused;
    // An alert is more urgent than an output that was never received.
    alertLine(model.waiting && !model.alert.state
      ? { ...model.alert, icon: "", text: model.waiting, sub: model.place, advice: "" } : model.alert);
    for (const each of document.querySelectorAll("#tiles .tile:not(.ages)")) tile(each.id, model.angles[each.id]);
    states(model);
    ages(model.ages, model.foot);
    sources(model.sources);
    ribbons(model.ribbons);
  }

  // Content of the screen without a link: every value is old, and its age is shown.
  function withoutLink(model, silentS) {
    const old = structuredClone(model);
    for (const angle of Object.values(old.angles)) {
      const ageS = angle.age_s === null ? null : angle.age_s + silentS;
      Object.assign(angle, { is_old: true, safety: "UNSAFE", reason: "no link to the monitor", is_reason: true, bar: null });
      angle.accuracy = ageS === null ? "—" : "OLD " + age(ageS);
      if (silentS > 60) angle.number = "—";
    }
    old.overall = { safety: "UNSAFE", text: "no link to the monitor" };
    old.ages = old.ages.map(([name, text, ageS]) => [name, ageS === null ? text : age(ageS + silentS)]);
    for (const row of old.sources.rows) if (row.age_s !== null) row.age = age(row.age_s + silentS);
    if (old.sources.is_known) old.sources.head = "last: " + old.sources.head;
    old.sources.is_known = false;
    old.alert.text = (linked ? "NO LINK " : "CONNECTING ") + age(silentS);
    old.alert.sub = linked ? "the page reconnects by itself" : "";
    Object.assign(old.alert, { icon: "", state: "lost", advice: "", unack: 0 });
    return old;
  }
  function age(seconds) {
    return seconds < 100 ? Math.round(seconds) + " s" : seconds < 6000 ? Math.round(seconds / 60) + " min" : Math.round(seconds / 3600) + " h";
  }

  function watchLink() {
    const nowMs = performance.now(), silentMs = nowMs - receivedMs, isLate = nowMs - lookedMs > 2 * limits.lookMs;
    lookedMs = nowMs;
    // The page itself was busy: texts received meanwhile are not read yet.
    if (isLate && silentMs < limits.busyMs) return;
    if (silentMs < limits.linkLostMs || last === null) return;
    lost = true;
    document.documentElement.classList.add("nolink");
    draw(withoutLink(last, silentMs / 1000));
    if (linked && silentMs > limits.reloadAfterMs && !checking) {
      checking = true;
      fetch("health", { cache: "no-store", signal: AbortSignal.timeout(2000) })
        .then((answer) => answer.ok, () => false)
        // A server that was only busy answers this request, then sends its texts over the existing link.
        .then((isAlive) => setTimeout(() => {
          checking = false;
          if (isAlive && performance.now() - receivedMs > limits.reloadAfterMs) location.reload();
        }, 1000));
    }
  }

  // The marked source in the list and in every panel. The mark and the angle of the budget are kept after a
  // change of theme and after a reconnect.
  function mark(name) {
    marked = name;
    sessionStorage.setItem("marked", marked);
    if (last !== null) sources(last.sources);
    sendChoice({ marked });
  }
  const toggle = (name) => mark(name === marked ? "" : name);
  // The user's choices go to the server's model of this page only, which draws the plots. `turn` makes each message
  // different, so that the same choice can be sent twice.
  let choice = { paused: false, wanted: false, seen: null, marked }, chosen = null, turn = 0;
  function sendChoice(change, once = {}) {
    choice = { ...choice, ...change };
    if (!chosen) return;
    turn += 1;
    const values = { ...choice, live: false, angle: "", ...once, turn };
    chosen.data = Object.fromEntries(Object.entries(values).map(([name, value]) => [name, [value]]));
  }
  function pause() {
    const isLive = at("paused").hidden;
    at("paused").hidden = !isLive;
    sendChoice({ paused: isLive }, { live: !isLive });
  }

  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || /INPUT|SELECT|TEXTAREA/.test(event.target.tagName)) return;
    if ("123".includes(event.key)) document.querySelectorAll("#themes a")[event.key - 1].click();
    if (event.key === "Escape") mark("");
    if (event.key === " ") { event.preventDefault(); if (!play()) pause(); }
    if (event.key in steps && move(event)) event.preventDefault();
  });
  // Keys for a bag: play and move the time.
  const steps = { ArrowLeft: -10, ArrowRight: 10, Home: -Infinity, End: Infinity };
  const widget = (name) => window.Bokeh && Bokeh.documents.length ? Bokeh.documents[0].get_model_by_name(name) : null;
  function play() {
    const button = widget("play");
    if (button) button.active = !button.active;
    return button !== null;
  }
  function move(event) {
    const slider = widget("time");
    if (!slider) return false;
    const wanted = slider.value + steps[event.key] * (event.shiftKey ? 6 : 1);
    slider.value = Math.min(slider.end, Math.max(slider.start, wanted));
    slider.value_throttled = slider.value;
    return true;
  }
  at("alert").onclick = () => { if (last && last.alert.all.length) at("alerts").hidden = !at("alerts").hidden; };
  function showPlots() {
    document.body.classList.add("plots");
    sessionStorage.setItem("plots", "wanted");
  }
  if (sessionStorage.getItem("plots")) showPlots();
  at("plots-wanted").onclick = showPlots;
  // The panels are made when the first of them becomes visible; each panel is updated only while it is visible.
  const want = new IntersectionObserver((entries) => {
    if (!entries.at(-1).isIntersecting) return;
    want.disconnect();
    sendChoice({ wanted: true });
  }, { rootMargin: "-8px" });
  want.observe(at("panels"));
  const inSight = new Map();
  const sight = new IntersectionObserver((entries) => {
    for (const entry of entries) inSight.get(entry.target).isSeen = entry.isIntersecting;
    sendVisiblePanels();
  });
  function sendVisiblePanels() {
    const seen = [...inSight.values()].filter((panel) => panel.isSeen && !document.hidden).map((panel) => panel.name);
    if (seen.join(" ") !== choice.seen) sendChoice({ seen: seen.join(" ") });
  }
  document.addEventListener("visibilitychange", sendVisiblePanels);
  // Bokeh creates the views of new models a little later.
  function watchPanels(models) {
    const views = models.map((model) => Bokeh.index.find_one(model));
    if (!views.every((view) => view && view.el.isConnected)) { setTimeout(watchPanels, 50, models); return; }
    views.forEach((view, index) => { inSight.set(view.el, { name: models[index].name, isSeen: false }); });
    for (const view of views) sight.observe(view.el);
    document.body.classList.add("drawn");
  }
  for (const each of document.querySelectorAll("#tiles .tile:not(.ages)")) {
    each.onclick = () => {
      showPlots();
      sessionStorage.setItem("angle", each.id);
      sendChoice({ wanted: true }, { angle: each.id });
      at("panels").scrollIntoView({ block: "start" });
    };
    each.onpointermove = (event) => {
      if (!each.tip || event.pointerType === "touch") return;
      const tip = at("tip");
      text(tip, each.tip.join("\n"));
      tip.hidden = false;
      tip.style.left = Math.min(event.clientX + 16, innerWidth - tip.offsetWidth - 8) + "px";
      tip.style.top = event.clientY + 16 + "px";
    };
    each.onpointerleave = () => { at("tip").hidden = true; };
  }
  setInterval(watchLink, limits.lookMs);

  return {
    limits,
    isLinked: () => linked && !lost,
    watchPanels,
    show(model) {
      last = model;
      receivedMs = performance.now();
      if (lost) document.documentElement.classList.remove("nolink");
      lost = false;
      draw(model);
    },
    // The first message over the link: from now on missing messages mean a lost link.
    connected(source) {
      linked = true;
      chosen = source;
      sendChoice({}, { angle: sessionStorage.getItem("angle") || "" });
    },
  };
})();
