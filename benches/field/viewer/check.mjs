// Opens fields with programs of others. `npm install` here, then
//   node check.mjs FIELD.glb [I LIT.png] [SHOT.png]
// 1. The Khronos glTF validator: no errors and no warnings.
// 2. three.js in a headless Chromium ($CHROMIUM, /usr/bin/chromium) shows the preview; SHOT.png is what it shows.
// 3. With I and LIT.png: KTX2 textures, read by ktx-parse, go to WebGL as they are; a shader sums the layers with the weights of light I.
//    It must give LIT.png, which `translume field relight` wrote for that light. For fields with whole layers (--tiles whole) on a
//    scale with a logarithm, whose interpolation goes through the lights (--interpolation gaussian), of 8-bit pictures (white is 1).
import { createServer } from 'node:http';
import { readFileSync, writeFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { fileURLToPath } from 'node:url';
import { chromium } from 'playwright-core';

const [path, ...rest] = process.argv.slice(2);
const light = rest.length >= 2 ? { index: Number(rest[0]), png: rest[1] } : null;
const shot = rest.length % 2 ? rest.at(-1) : null;
const here = fileURLToPath(new URL('.', import.meta.url));
const bytes = readFileSync(path);
const fail = (what) => { console.error(`${path}: ${what}`); process.exitCode = 1; };

const validator = createRequire(import.meta.url)('gltf-validator');
const { issues } = await validator.validateBytes(new Uint8Array(bytes));
console.log(`Khronos validator: ${issues.numErrors} errors, ${issues.numWarnings} warnings, ${issues.numInfos} notes`);
if (issues.numErrors + issues.numWarnings > 0) fail(JSON.stringify(issues.messages, null, 1));

const page = `<!doctype html><script type="importmap">{"imports":{"three":"/node_modules/three/build/three.module.js",
"three/addons/":"/node_modules/three/examples/jsm/","ktx-parse":"/node_modules/ktx-parse/dist/index.mjs"}}</script>
<body style="margin:0"><script type="module" src="/page.mjs"></script>`;
const type = { mjs: 'text/javascript', js: 'text/javascript' };
const server = createServer((request, answer) => {
  try {
    const name = request.url;
    const body = name === '/' ? page : name === '/field' ? bytes : name === '/lit' ? readFileSync(light.png) : readFileSync(here + name);
    answer.writeHead(200, { 'content-type': name === '/' ? 'text/html' : type[name.split('.').at(-1)] ?? 'application/octet-stream' });
    answer.end(body);
  } catch { answer.writeHead(404).end(); }
}).listen(0, '127.0.0.1');
await new Promise((done) => server.on('listening', done));
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
  args: ['--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--disable-quic', '--disable-background-networking', '--disable-component-update', '--disable-sync'],
});
try {
  const tab = await browser.newPage({ viewport: { width: 512, height: 512 } });
  tab.on('console', (m) => { if (m.type() === 'error' && !m.text().includes('404')) fail(m.text()); });
  tab.on('pageerror', (e) => fail(e.message));
  await tab.goto(`http://127.0.0.1:${server.address().port}/`);
  await tab.waitForFunction('window.ready', null, { timeout: 60000 });
  const shown = await tab.evaluate('window.preview()');
  console.log(`three.js: the preview, mean ${shown.mean.toFixed(3)}, standard deviation ${shown.deviation.toFixed(3)}`);
  if (!(shown.deviation > 0.01)) fail('three.js shows nothing');
  if (shot) writeFileSync(shot, Buffer.from(shown.png.split(',')[1], 'base64'));
  if (light) {
    const found = await tab.evaluate(`window.relit(${light.index})`);
    console.log(`WebGL: ${found.layers} layers of ${found.formats.join(', ')}: RMS ${found.rms.toFixed(5)}, most ${found.most} of 255`);
    if (!(found.rms < 0.005)) fail('the shader gives another picture');
  }
} finally {
  await browser.close();
  server.close();
}
