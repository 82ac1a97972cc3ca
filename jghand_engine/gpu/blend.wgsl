// Front to back over the list of a tile: weight = alpha T, T -= weight; color, depth and coverage are sums of weights
// (RENDERING 3). A workgroup per tile, a thread per pixel. Records and lists are those of native/raster.h.

struct Picture {
  width: u32, height: u32, tiles_x: u32, fills: u32,  // fills: see `front` in native/raster.h
  log2_alpha_min: f32, alpha_max: f32, t_stop: f32, also_unused: f32,
}

@group(0) @binding(0) var<uniform> picture: Picture;
@group(0) @binding(1) var<storage, read> records: array<vec4f>;     // 4 of each: u v xx xy | yy log2_opacity r g | b z - front
@group(0) @binding(2) var<storage, read> tile_start: array<u32>;    // where each tile's list begins; one more, the end
@group(0) @binding(3) var<storage, read> tile_list: array<u32>;     // records, front to back per tile
@group(0) @binding(4) var<storage, read_write> planes: array<f32>;  // premultiplied R G B, alpha, sum of weight times depth

// as in native/constants.h
const FRONT_MIN = 0.04;
const COVER_FROM = 0.15;
const BENEATH_FROM = 0.1;
const BENEATH_WHOLE = 0.5;
const COVER_WHOLE = 0.9;
// 12 KiB of the 16 that every WebGPU device has
const CHUNK = 256u;
var<workgroup> shapes: array<vec4f, CHUNK>;
var<workgroup> opacities: array<vec4f, CHUNK>;
var<workgroup> others: array<vec3f, CHUNK>;
var<workgroup> any_open: atomic<u32>;
var<workgroup> going_on: u32;

@compute @workgroup_size(16, 16)
fn main(@builtin(workgroup_id) tile_at: vec3u, @builtin(local_invocation_id) in_tile: vec3u,
        @builtin(local_invocation_index) thread: u32) {
  let tile = tile_at.y * picture.tiles_x + tile_at.x;
  let end = tile_start[tile + 1u];
  let at = 16u * tile_at.xy + in_tile.xy;
  let center = vec2f(at) + 0.5;
  let on_picture = at.x < picture.width && at.y < picture.height;
  var open = on_picture;
  // with `front` a pixel is covered once nothing beneath adds to its color
  let least = select(0.0, BENEATH_FROM, picture.fills != 0u);
  let stop = select(picture.t_stop, BENEATH_FROM, picture.fills != 0u);
  var T = 1.0;
  var color = vec3f(0.0);
  var depth = 0.0;
  var front = 0.0;
  for (var first = tile_start[tile]; first < end; first += CHUNK) {
    let length = min(CHUNK, end - first);
    if (thread == 0u) { atomicStore(&any_open, 0u); }
    workgroupBarrier();
    if (open) { atomicStore(&any_open, 1u); }
    if (thread < length) {
      let record = 4u * tile_list[first + thread];
      shapes[thread] = records[record];
      opacities[thread] = records[record + 1u];
      others[thread] = records[record + 2u].xyw;
    }
    workgroupBarrier();
    if (thread == 0u) { going_on = atomicLoad(&any_open); }
    if (workgroupUniformLoad(&going_on) == 0u) { break; }  // the same for all threads, as barriers in a loop want it
    if (open) {
      for (var k = 0u; k < length; k++) {
        let shape = shapes[k];
        let rest = opacities[k];
        let other = others[k];
        let d = center - shape.xy;
        let exponent = (d.x * shape.z + d.y * shape.w) * d.x + (d.y * d.y * rest.x + rest.y);
        if (!(exponent > picture.log2_alpha_min)) { continue; }
        let weight = min(exp2(exponent), picture.alpha_max) * T;
        let part = saturate((T - BENEATH_FROM) / (BENEATH_WHOLE - BENEATH_FROM));
        let shown = select(weight, weight * part, picture.fills != 0u);
        let beneath = max(T - weight, least);
        color += shown * vec3f(rest.zw, other.x);
        depth += (T - beneath) * other.y;
        front += shown * other.z;
        T = beneath;
        if (!(T > stop)) { open = false; break; }
      }
    }
    workgroupBarrier();
  }
  if (!on_picture) { return; }
  var alpha = 1.0 - T;
  if (picture.fills != 0u && alpha > 0.0) {
    let cover = smoothstep(COVER_FROM, COVER_WHOLE, alpha);
    color *= cover / max(front, FRONT_MIN * alpha);
    depth *= cover / alpha;
    alpha = cover;
  }
  let size = picture.width * picture.height;
  let pixel = at.y * picture.width + at.x;
  planes[pixel] = color.x;
  planes[pixel + size] = color.y;
  planes[pixel + 2u * size] = color.z;
  planes[pixel + 3u * size] = alpha;
  planes[pixel + 4u * size] = depth;
}
