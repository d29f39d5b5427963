// SPDX-License-Identifier: Apache-2.0
// Chromium over the dashboard's page, told what to do by lines on stdin, each answered with one line
// of JSON. What is right and wrong is judged by who asks (tests/rt/dashboard_browser_test.cpp).
"use strict";
const fs = require("node:fs");
const readline = require("node:readline");
const { chromium } = require("playwright-core");

const kAxe = fs.readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
let browser, page;
let problems = [];

async function open(url, width, height) {
  browser ??= await chromium.launch({
    executablePath: process.env.HOLDFAST_CHROMIUM ?? "/usr/bin/chromium",
    args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
  });
  await page?.context().close();
  problems = [];
  const context = await browser.newContext({ viewport: { width: Number(width), height: Number(height) } });
  page = await context.newPage();
  page.on("pageerror", (error) => problems.push(`error: ${error.message}`));
  page.on("console", (m) => ["error", "warning"].includes(m.type()) && problems.push(`${m.type()}: ${m.text()}`));
  page.on("request", (request) => {
    if (new URL(request.url()).origin !== new URL(url).origin) problems.push(`outside: ${request.url()}`);
  });
  await page.addInitScript(() => {
    document.addEventListener("securitypolicyviolation", (e) => console.error(`CSP: ${e.violatedDirective} ${e.blockedURI}`));
  });
  const response = await page.goto(url);
  return { status: response.status(), url: page.url() };
}

/// What a person sees first, and what a screen reader hears.
const look = () => page.evaluate(() => {
  const get = (id) => document.getElementById(id);
  const is_covered = Number(getComputedStyle(get("expired")).opacity) > 0.5;
  return {
    is_covered,
    level: get("permission").className,
    word: is_covered ? get("expired").querySelector("strong").textContent : get("word").textContent,
    heard: get("word").textContent,
    reason: get("reason").textContent,
    title: document.title,
    ground: getComputedStyle(is_covered ? get("expired") : get("permission")).backgroundColor,
    answers: Number(document.body.dataset.answers ?? 0),
    status: get("tracking").textContent,
    stops: get("stops").textContent,
    registration: get("registration").textContent,
    devices: get("devices").textContent,
    drawn: Number(get("surfaces").dataset.drawn ?? 0),
    surfaces_note: get("surfaces-note").textContent,
    is_plotted: [...document.querySelectorAll(".plot canvas")].length,
  };
});

/// What a person sees of the live view, with the colours [r, g, b, a] at places of its canvas, "x,y x,y".
const live = (...places) => page.evaluate((wanted) => {
  const get = (id) => document.getElementById(id);
  const g = new OffscreenCanvas(get("live").width, get("live").height).getContext("2d", { willReadFrequently: true });
  g.drawImage(get("live"), 0, 0);
  return {
    is_covered: Number(getComputedStyle(get("live-cover")).opacity) > 0.5,
    note: get("live-note").textContent,
    frame: Number(document.body.dataset.live ?? -1),
    width: get("live").width,
    colours: wanted.map((place) => [...g.getImageData(...place.split(",").map(Number), 1, 1).data]),
  };
}, places);

async function click(id) {
  await page.click(`#${id}`);
  return {};
}

/// Sections whose content does not fit and that do not scroll either, and the page's own overflow.
const overflow = () => page.evaluate(() => {
  const root = document.documentElement;
  const cut = [...document.querySelectorAll("main > section, header > :not(h1), main dd")].filter((e) =>
    e.scrollHeight > e.clientHeight + 1 || e.scrollWidth > e.clientWidth + 1);
  return {
    right: root.scrollWidth - root.clientWidth,
    below: root.scrollHeight - root.clientHeight,
    cut: cut.map((e) => `${e.id || e.getAttribute("aria-labelledby") || e.textContent}: ${e.scrollWidth}x${e.scrollHeight} in ${e.clientWidth}x${e.clientHeight}`),
  };
});

async function axe() {
  const session = await page.context().newCDPSession(page);
  await session.send("Runtime.evaluate", { expression: kAxe }); // past the page's CSP, as a tool may
  const expression = "axe.run().then((r) => JSON.stringify({ violations: r.violations.map((v) => `${v.id}: ${v.nodes.map((n) => n.html).join(' ')}`), passes: r.passes.map((p) => p.id) }))";
  const { result } = await session.send("Runtime.evaluate", { expression, awaitPromise: true, returnByValue: true });
  return JSON.parse(result.value);
}

/// Hangs the page's script for `ms` and returns the colour at a place (shares of width and height;
/// the permission's right end) in each picture that the browser composed meanwhile, newest last.
async function hang(ms, across = "0.97", down = String(40 / 768)) {
  const session = await page.context().newCDPSession(page);
  const pictures = [];
  session.on("Page.screencastFrame", ({ data, sessionId }) => {
    pictures.push(data);
    session.send("Page.screencastFrameAck", { sessionId }).catch(() => {});
  });
  await session.send("Page.startScreencast", { format: "png", everyNthFrame: 1 });
  await page.evaluate((duration) => {
    const end = performance.now() + duration;
    while (performance.now() < end);
  }, Number(ms));
  const count = pictures.length; // what came while nothing of the page could run
  await session.send("Page.stopScreencast");
  const viewer = await page.context().newPage();
  const colours = [];
  for (const picture of pictures.slice(0, count))
    colours.push(await viewer.evaluate(async ([data, x, y]) => {
      const image = new Image();
      image.src = `data:image/png;base64,${data}`;
      await image.decode();
      const canvas = new OffscreenCanvas(image.width, image.height);
      const g = canvas.getContext("2d");
      g.drawImage(image, 0, 0);
      return [...g.getImageData(Math.round(x * image.width), Math.round(y * image.height), 1, 1).data];
    }, [picture, Number(across), Number(down)]));
  await viewer.close();
  return { colours };
}

async function picture(file) {
  await page.screenshot({ path: file });
  return {};
}

const commands = { open, look, live, click, overflow, axe, hang, picture, problems: async () => ({ problems }) };

async function main() {
  for await (const line of readline.createInterface({ input: process.stdin })) {
    const [name, ...words] = line.split(" ");
    let answer;
    try {
      answer = await commands[name](...words);
    } catch (error) {
      answer = { error: String(error.message).split("\n")[0] };
    }
    process.stdout.write(`${JSON.stringify(answer)}\n`);
  }
  await browser?.close();
}
main();
