import { COLOUR_MAP } from "./colours.js";

/** Normals of the vertices, rendered to one texel each: a mean over the triangles around the vertex. */
export const normalsShader = {
  vertex: `void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }`,
  fragment: `
    precision highp float; precision highp usampler2D;
    uniform sampler2D positions; uniform usampler2D neighbours;
    out vec4 result;
    vec3 at(uint vertex) { return texelFetch(positions, ivec2(int(vertex) % WIDTH, int(vertex) / WIDTH), 0).rgb; }
    void main() {
      ivec2 pixel = ivec2(gl_FragCoord.xy);
      vec3 here = at(uint(pixel.y * WIDTH + pixel.x)), sum = vec3(0.0);
      for (int k = 0; k < MAX_NEIGHBOURS; k++) {
        uvec2 others = texelFetch(neighbours, ivec2(pixel.x * MAX_NEIGHBOURS + k, pixel.y), 0).rg;
        if (others.x == others.y) break;
        vec3 a = at(others.x) - here, b = at(others.y) - here;
        sum += cross(a, b) / max(dot(a, a) * dot(b, b), 1e-30); // exact on a sphere (Max 1999)
      }
      result = vec4(sum * inversesqrt(max(dot(sum, sum), 1e-30)), 1.0);
    }`,
};

/** Lights fixed to the camera. */
const LIGHTS = `
  const vec3 KEY = normalize(vec3(-0.42, 0.68, 0.60));
  const vec3 FILL = normalize(vec3(0.75, 0.12, 0.52));
  vec3 srgb(vec3 c) { return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c)); }
  vec3 linear(vec3 c) { return pow(max(c, 0.0), vec3(2.2)); }`;

/** Shaded colour of the surface, from a normal and a position in eye coordinates, a scalar, and the share of a support. */
const SHADE = `
  const vec3 PALE = vec3(0.30, 0.23, 0.20); // reflectance of a support
  uniform vec2 range; uniform float shown; uniform mat4 viewMatrixOf;
  ${LIGHTS} ${COLOUR_MAP}
  vec3 shade(vec3 n, vec3 eye, float value, float support, float mottled, float wet) {
    vec3 view = normalize(-eye);
    float t = shown * clamp(value, range.x, range.y) / max(range.y, 1e-30);
    float covered = flatness(t), matte = smoothstep(0.4, 0.6, support);
    vec3 albedo = mix(mottled, 1.0, covered) * reflectance(t);
    albedo = mix(albedo, PALE, 0.6 * matte * (1.0 - covered));
    // subsurface scattering, strongest for red
    vec3 wrap = mix(vec3(0.52, 0.24, 0.20), vec3(0.35), covered);
    vec3 key = pow(max((dot(n, KEY) + wrap) / (1.0 + wrap), 0.0), vec3(1.3));
    vec3 fill = max((dot(n, FILL) + wrap) / (1.0 + wrap), 0.0);
    float sky = 0.5 + 0.5 * dot(n, viewMatrixOf[2].xyz);
    vec3 light = 1.75 * key * vec3(1.0, 0.97, 0.93) + 0.38 * fill * vec3(0.88, 0.94, 1.0)
               + mix(vec3(0.20, 0.17, 0.16), vec3(0.40, 0.42, 0.46), sky);
    light = mix(light, 0.42 + 0.36 * light, covered); // keeps colours readable on the legend
    float edge = pow(1.0 - clamp(dot(n, view), 0.0, 1.0), 4.0);
    float gloss = wet * (1.0 - 0.7 * covered) * (1.0 - matte);
    vec3 half1 = normalize(KEY + view);
    float shine = 0.24 * pow(max(dot(n, half1), 0.0), 90.0);
    #ifdef FINE
      shine += 0.035 * pow(max(dot(n, half1), 0.0), 16.0);
      shine += 0.03 * pow(max(dot(n, normalize(FILL + view)), 0.0), 26.0);
    #endif
    vec3 colour = albedo * light + gloss * shine
                + edge * (1.0 - 0.6 * covered) * (0.07 * vec3(1.0, 0.84, 0.80) + 0.6 * albedo) * (0.3 + 0.7 * sky);
    return srgb(clamp(colour, 0.0, 1.0));
  }`;

/** Darker stripes across the screen where the surface is fixed, and lighter ones, the other way, where the image cuts it off. */
const HATCH = `
  float hatch(float support) {
    if (support < 0.4) return 1.0;
    return 1.0 - 0.16 * smoothstep(0.4, 0.6, support) * step(0.6, fract((gl_FragCoord.x + gl_FragCoord.y) / 9.0));
  }
  vec3 hatched(vec3 colour, vec2 marks) { // whether it is fixed, and cut off
    float line = smoothstep(0.45, 0.55, marks.y) * step(0.72, fract((gl_FragCoord.x - gl_FragCoord.y) / 9.0));
    return mix(hatch(marks.x) * colour, vec3(0.93, 0.90, 0.86), 0.55 * line);
  }`;

/** A cubic patch over a triangle with given normals at its corners (Vlachos et al. 2001). */
const PATCH = `
  vec3 bent(vec3 p, vec3 n, vec3 to) { // control point at a third of an edge, in the tangent plane except at a crease
    vec3 along = to - p;
    float rise = dot(along, n);
    float smoothly = 1.0 - smoothstep(0.4, 0.65, abs(rise) * inversesqrt(max(dot(along, along), 1e-30)));
    return p + (along - smoothly * rise * n) / 3.0;
  }
  vec3 patched(vec3 w, vec3 a, vec3 b, vec3 c, vec3 na, vec3 nb, vec3 nc) {
    vec3 ab = bent(a, na, b), ba = bent(b, nb, a), bc = bent(b, nb, c), cb = bent(c, nc, b);
    vec3 ca = bent(c, nc, a), ac = bent(a, na, c);
    vec3 edges = (ab + ba + bc + cb + ca + ac) / 6.0, centre = 1.5 * edges - (a + b + c) / 6.0;
    return w.x * w.x * (w.x * a + 3.0 * (w.y * ab + w.z * ac)) + w.y * w.y * (w.y * b + 3.0 * (w.x * ba + w.z * bc))
         + w.z * w.z * (w.z * c + 3.0 * (w.x * ca + w.y * cb)) + 6.0 * w.x * w.y * w.z * centre;
  }`;

/** The body. With LIT, for software rendering, colours are computed at vertices instead of pixels. */
export const bodyShader = {
  vertex: `
    uniform sampler2D normals;
    #ifdef LIT
      ${SHADE}
      out vec3 colour;
    #else
      out vec3 eye, smoothed, place; out float value;
    #endif
    out vec2 marks;
    vec3 normalOf(int k) { return texelFetch(normals, ivec2(k % WIDTH, k / WIDTH), 0).xyz; }
    #ifdef REFINED
      // a curved patch over each triangle; position: u, v
      uniform sampler2D positions, rests, scalars;
      in vec3 corners;
      vec3 three(sampler2D numbers, int k) { return texelFetch(numbers, ivec2(k % WIDTH, k / WIDTH), 0).rgb; }
      ${PATCH}
    #else
      in vec3 scalar, rest; // scalar, and 1 where the surface is fixed, and where the image cuts it off
    #endif
    void main() {
      #ifdef REFINED
        ivec3 k = ivec3(corners + 0.5);
        vec3 w = vec3(1.0 - position.x - position.y, position.xy);
        vec3 na = normalOf(k.x), nb = normalOf(k.y), nc = normalOf(k.z);
        vec3 a = three(positions, k.x), b = three(positions, k.y), c = three(positions, k.z);
        vec3 here = patched(w, a, b, c, na, nb, nc);
        vec3 number = vec3(0.0);
        for (int j = 0; j < 3; j++) number += w[j] * texelFetch(scalars, ivec2(k[j] % WIDTH, k[j] / WIDTH), 0).rgb;
        vec3 mean = w.x * na + w.y * nb + w.z * nc;
        #ifndef LIT
          place = w.x * three(rests, k.x) + w.y * three(rests, k.y) + w.z * three(rests, k.z);
        #endif
      #else
        vec3 here = position;
        vec3 number = scalar;
        #ifdef SMOOTH
          vec3 mean = normalOf(gl_VertexID);
        #else
          vec3 mean = vec3(0.0);
        #endif
        #ifndef LIT
          place = rest;
        #endif
      #endif
      vec4 seen = modelViewMatrix * vec4(here, 1.0);
      #ifdef LIT
        vec3 n = normalize(normalMatrix * mean);
        #ifdef TWO_FACED
          n *= dot(n, seen.xyz) > 0.0 ? -1.0 : 1.0;
        #endif
        colour = shade(n, seen.xyz, number.x, number.y, 1.0, 1.0);
      #else
        eye = seen.xyz; value = number.x;
        smoothed = normalMatrix * mean;
      #endif
      marks = number.yz;
      gl_Position = projectionMatrix * seen;
    }`,
  fragment: `
    precision highp float;
    uniform float veil;
    in vec2 marks;
    out vec4 result;
    ${HATCH}
    #ifdef LIT
      in vec3 colour;
      void main() { result = vec4(hatched(colour, marks), 1.0) * veil; }
    #else
      uniform float size;
      in vec3 eye, smoothed, place; in float value;
      ${SHADE}
      float hash(vec3 p) { p = fract(p * 0.3183099 + 0.1); p *= 17.0; return fract(p.x * p.y * p.z * (p.x + p.y + p.z)); }
      float noise(vec3 x) {
        vec3 i = floor(x), f = fract(x); f = f * f * (3.0 - 2.0 * f);
        vec2 e = vec2(0.0, 1.0);
        return mix(mix(mix(hash(i), hash(i + e.yxx), f.x), mix(hash(i + e.xyx), hash(i + e.yyx), f.x), f.y),
                   mix(mix(hash(i + e.xxy), hash(i + e.yxy), f.x), mix(hash(i + e.xyy), hash(i + 1.0), f.x), f.y), f.z);
      }
      /** Perturb a normal by a height field, from screen-space derivatives (Mikkelsen 2010). */
      vec3 uneven(vec3 n, float height) {
        vec3 x = dFdx(eye), y = dFdy(eye), across = cross(y, n), along = cross(n, x);
        float area = dot(x, across);
        return normalize(abs(area) * n - sign(area) * (dFdx(height) * across + dFdy(height) * along));
      }
      void main() {
        #ifdef SMOOTH
          vec3 n = normalize(smoothed);
          #ifdef TWO_FACED
            n *= dot(n, eye) > 0.0 ? -1.0 : 1.0;
          #endif
        #else
          vec3 n = normalize(cross(dFdx(eye), dFdy(eye)));
        #endif
        float mottled = 1.0, wet = 1.0;
        #ifdef FINE
          vec3 at = place / size;
          mottled = 0.84 + 0.32 * (0.6 * noise(9.0 * at) + 0.4 * noise(31.0 * at));
          wet = 0.6 + 0.7 * noise(14.0 * at + 7.0);
          n = uneven(n, size * (0.0011 * noise(38.0 * at) + 0.0028 * noise(16.0 * at)));
        #endif
        result = vec4(hatched(shade(n, eye, value, marks.x, mottled, wet), marks), 1.0) * veil;
      }
    #endif`,
};

/** A line on the surface of the body: a strip of a width in pixels, a little nearer than the surface. */
export const cutLineShader = {
  vertex: `
    const float NEARER = 0.996; // over the distance from the camera
    uniform sampler2D positions, normals;
    uniform vec2 window; uniform float width; // [px]
    in vec3 corners; in vec4 ends; // shares of the second and third corner at both ends; position: along, side
    vec3 three(sampler2D numbers, int k) { return texelFetch(numbers, ivec2(k % WIDTH, k / WIDTH), 0).rgb; }
    ${PATCH}
    vec4 at(float along) {
      ivec3 k = ivec3(corners + 0.5);
      vec2 uv = mix(ends.xy, ends.zw, along);
      vec3 w = vec3(1.0 - uv.x - uv.y, uv);
      vec3 a = three(positions, k.x), b = three(positions, k.y), c = three(positions, k.z);
      #ifdef REFINED
        vec3 here = patched(w, a, b, c, three(normals, k.x), three(normals, k.y), three(normals, k.z));
      #else
        vec3 here = w.x * a + w.y * b + w.z * c;
      #endif
      return modelViewMatrix * vec4(here, 1.0) * vec4(vec3(NEARER), 1.0);
    }
    void main() {
      float step = 0.05;
      vec4 here = projectionMatrix * at(position.x);
      vec4 before = projectionMatrix * at(max(position.x - step, 0.0)), after = projectionMatrix * at(min(position.x + step, 1.0));
      vec2 along = (after.xy / after.w - before.xy / before.w) * window;
      along *= inversesqrt(max(dot(along, along), 1e-12));
      float cap = position.x < step ? -0.3 : position.x > 1.0 - step ? 0.3 : 0.0; // closes the gaps at bends
      vec2 aside = width * (0.5 * position.y * vec2(-along.y, along.x) + cap * along);
      gl_Position = here + vec4(2.0 * here.w * aside / window, 0.0, 0.0);
    }`,
  fragment: `
    precision highp float;
    uniform vec3 colour;
    out vec4 result;
    void main() { result = vec4(colour, 1.0); }`,
};

/** Tool glyphs: opaque, or translucent for a preview. */
export const toolShader = {
  vertex: `
    out vec3 eye, n;
    void main() {
      vec4 seen = modelViewMatrix * vec4(position, 1.0);
      eye = seen.xyz; n = normalMatrix * normal;
      gl_Position = projectionMatrix * seen;
    }`,
  fragment: `
    precision highp float;
    uniform vec3 colour; uniform float opacity;
    in vec3 eye, n;
    out vec4 result;
    ${LIGHTS}
    void main() {
      vec3 m = normalize(n), view = normalize(-eye);
      float facing = clamp(dot(m, view), 0.0, 1.0);
      float key = max((dot(m, KEY) + 0.35) / 1.35, 0.0), fill = max((dot(m, FILL) + 0.3) / 1.3, 0.0);
      float sharp = pow(max(dot(m, normalize(KEY + view)), 0.0), 120.0);
      vec3 lit = linear(colour) * (0.85 * key + 0.22 * fill + 0.20) + 0.5 * sharp + 0.16 * pow(1.0 - facing, 3.0);
      float alpha = opacity * mix(1.0, 0.35 + 0.65 * pow(1.0 - facing, 1.5), step(opacity, 0.99));
      result = vec4(srgb(clamp(lit, 0.0, 1.0)) * alpha, alpha);
    }`,
};

/** Shapes around a body: clear where they face the camera, dense at their outlines; one is marked. They end softly at a panel. */
export const surroundingsShader = {
  vertex: `
    in vec2 number; // of the shape, and of its kind
    uniform float marked, hovered; uniform vec3 middle; uniform float radius; // of the body
    uniform vec3 colours[5];
    out vec3 eye, n; out float near;
    flat out vec3 colour; flat out vec2 chosen; // whether it is marked, and hovered
    void main() {
      vec4 seen = modelViewMatrix * vec4(position, 1.0);
      eye = seen.xyz; n = normalMatrix * normal;
      near = mix(1.0, 0.3, smoothstep(1.0, 2.2, distance(position, middle) / radius));
      colour = colours[int(number.y + 0.5)];
      chosen = 1.0 - step(0.5, abs(vec2(number.x) - vec2(marked, hovered)));
      gl_Position = projectionMatrix * seen;
    }`,
  fragment: `
    precision highp float;
    const float SOFT = 0.12; // share of the window, at its right and lower side, over which shapes fade
    uniform vec3 accent; uniform vec2 window; // [px]
    in vec3 eye, n; in float near;
    flat in vec3 colour; flat in vec2 chosen;
    out vec4 result;
    void main() {
      float facing = clamp(dot(normalize(n), normalize(-eye)), 0.0, 1.0);
      float rim = pow(1.0 - facing, 2.5);
      float alpha = near * (0.045 + 0.40 * rim);
      alpha = mix(alpha, 0.16 + 0.5 * rim, chosen.y);
      alpha = mix(alpha, 0.30 + 0.5 * rim, chosen.x);
      vec2 at = gl_FragCoord.xy / window;
      alpha *= smoothstep(0.0, SOFT, 1.0 - at.x) * smoothstep(0.0, SOFT, at.y);
      result = vec4(mix(colour, accent, chosen.x) * alpha, alpha);
    }`,
};

/** Blur of the shadow in one direction. */
export const blurShader = {
  vertex: `out vec2 at; void main() { at = 0.5 * position.xy + 0.5; gl_Position = vec4(position.xy, 0.0, 1.0); }`,
  fragment: `
    precision highp float;
    uniform sampler2D image; uniform vec2 along;
    in vec2 at; out vec4 result;
    void main() {
      float sum = 0.0, weights = 0.0;
      for (int k = -8; k <= 8; k++) {
        float weight = exp(-float(k * k) / 26.0);
        sum += weight * texture(image, at + float(k) * along).r; weights += weight;
      }
      result = vec4(vec3(sum / weights), 1.0);
    }`,
};

export const groundShader = {
  vertex: `
    out vec2 at; void main() { at = uv; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }`,
  fragment: `
    precision highp float;
    uniform sampler2D image; uniform float strength;
    in vec2 at; out vec4 result;
    void main() { result = vec4(vec3(0.0), strength * texture(image, at).r); }`,
};
