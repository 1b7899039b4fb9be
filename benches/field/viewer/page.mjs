// In the browser: see check.mjs.
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { read } from 'ktx-parse';

const field = await (await fetch('/field')).arrayBuffer();

window.preview = async () => {
  const renderer = new THREE.WebGLRenderer({ preserveDrawingBuffer: true });
  renderer.setSize(512, 512);
  const { scene } = await new GLTFLoader().parseAsync(field.slice(0), '');
  const camera = new THREE.OrthographicCamera(-0.5, 0.5, 0.5, -0.5, 0.1, 2);
  camera.position.z = 1;
  renderer.render(scene, camera);
  const gl = renderer.getContext();
  const pixels = new Uint8Array(4 * 512 * 512);
  gl.readPixels(0, 0, 512, 512, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  const green = Array.from({ length: 512 * 512 }, (_, i) => pixels[4 * i + 1] / 255);
  const mean = green.reduce((a, b) => a + b) / green.length;
  const deviation = Math.sqrt(green.reduce((a, b) => a + (b - mean) ** 2, 0) / green.length);
  return { mean, deviation, png: renderer.domElement.toDataURL() };
};

const view = new DataView(field);
const length = view.getUint32(12, true);
const document_ = JSON.parse(new TextDecoder().decode(new Uint8Array(field, 20, length)));
const bufferView = (i) => {
  const { byteOffset = 0, byteLength } = document_.bufferViews[i];
  return new Uint8Array(field, 28 + length + byteOffset, byteLength);
};

// Vulkan's number of a format: extension, member of it, whether texels are patterns of half floats.
const FORMATS = {
  131: ['WEBGL_compressed_texture_s3tc', 'COMPRESSED_RGB_S3TC_DXT1_EXT'],
  139: ['EXT_texture_compression_rgtc', 'COMPRESSED_RED_RGTC1_EXT'],
  143: ['EXT_texture_compression_bptc', 'COMPRESSED_RGB_BPTC_UNSIGNED_FLOAT_EXT', true],
  145: ['EXT_texture_compression_bptc', 'COMPRESSED_RGBA_BPTC_UNORM_EXT'],
};

const VERTEX = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0, 1); }`;
// One layer, added to the sum: weight by channel of the layer, then of the picture.
const LAYER = `#version 300 es
precision highp float; precision highp sampler2DArray;
uniform sampler2DArray texels; uniform int layer, height; uniform bool halfs; uniform vec3 low, range; uniform mat3 weight;
out vec4 sum;
void main() {
  vec3 t = texelFetch(texels, ivec3(gl_FragCoord.x, float(height) - gl_FragCoord.y, layer), 0).rgb;
  if (halfs) t = vec3(packHalf2x16(vec2(t.r, 0)), packHalf2x16(vec2(t.g, 0)), packHalf2x16(vec2(t.b, 0))) / 31743.0;
  sum = vec4(weight * (low + t * range), 0);
}`;

window.relit = async (index) => {
  const f = document_.extensions.TRANSLUME_reflectance_field;
  const { width, height } = f;
  const canvas = Object.assign(document.createElement('canvas'), { width, height });
  const gl = canvas.getContext('webgl2');
  gl.getExtension('EXT_color_buffer_float');
  gl.getExtension('EXT_float_blend');
  const formats = [];
  const textures = f.textures.map((at) => {
    const file = read(bufferView(at));
    const [extension, member, halfs = false] = FORMATS[file.vkFormat];
    formats.push(member);
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D_ARRAY, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.compressedTexImage3D(gl.TEXTURE_2D_ARRAY, 0, gl.getExtension(extension)[member], file.pixelWidth, file.pixelHeight, file.layerCount, 0, file.levels[0].levelData);
    return { texture, halfs };
  });
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, LAYER]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  gl.useProgram(program);
  const at = (name) => gl.getUniformLocation(program, name);
  gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
  const target = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, target);
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, width, height);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target, 0);
  gl.viewport(0, 0, width, height);
  const w = f.weights;
  const packed = bufferView(w.weightsView);
  const codes = w.bits === 16 ? new Uint16Array(packed.slice().buffer) : packed;
  const row = w.low.map((low, j) => low + (codes[index * w.low.length + j] / (2 ** w.bits - 1)) * (w.high[j] - low));
  let column = w.colour ? 3 : 0;
  const constant = w.colour ? row.slice(0, 3) : [0, 0, 0];
  gl.clearColor(...constant, 0);
  gl.clear(gl.COLOR_BUFFER_BIT);
  gl.enable(gl.BLEND);
  gl.blendFunc(gl.ONE, gl.ONE);
  for (const layer of f.layers) {
    const { texture, halfs } = textures[layer.texture];
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, texture);
    const weight = new Float32Array(9);
    for (let k = 0; k < layer.low.length; k++) {
      for (let c = 0; c < 3; c++) weight[3 * k + c] = w.colour ? row[column + 3 * k + c] : k === c ? row[column] : 0;
    }
    column += w.colour ? 3 * layer.low.length : 1;
    const three = (v) => [v[0], v[1] ?? 0, v[2] ?? 0];
    gl.uniform1i(at('layer'), layer.layer);
    gl.uniform1i(at('height'), height);
    gl.uniform1i(at('halfs'), halfs);
    gl.uniform3fv(at('low'), three(layer.low));
    gl.uniform3fv(at('range'), three(layer.high.map((h, i) => h - layer.low[i])));
    gl.uniformMatrix3fv(at('weight'), false, weight);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
  const sums = new Float32Array(4 * width * height);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, sums);
  if (gl.getError()) throw new Error('WebGL refused something');
  const image = await createImageBitmap(await (await fetch('/lit')).blob());
  const flat = new OffscreenCanvas(width, height).getContext('2d');
  flat.drawImage(image, 0, 0);
  const truth = flat.getImageData(0, 0, width, height).data;
  const srgb = (x) => (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);
  let [squares, most] = [0, 0];
  for (let y = 0; y < height; y++) for (let i = 0; i < 4 * width; i++) {
    if (i % 4 === 3) continue;
    // Row 0 of a frame buffer is the lowest.
    const value = Math.max(Math.exp(sums[4 * width * (height - 1 - y) + i]) - f.domain.delta, 0);
    const light = f.domain.kind === 'root' ? value * value : value;
    const off = Math.abs(Math.round(255 * srgb(Math.min(light, 1))) - truth[4 * width * y + i]);
    most = Math.max(most, off);
    squares += (off / 255) ** 2;
  }
  return { rms: Math.sqrt(squares / (3 * width * height)), most, layers: f.layers.length, formats };
};
window.ready = true;
