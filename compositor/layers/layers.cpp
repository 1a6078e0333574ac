#include "compositor/layers/layers.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "prt/clip/light_map.h"

namespace penumbra::compositor {

namespace {

using LayerDrawing = LayerPrograms::LayerDrawing;

void attribute(GLuint location, int components, std::size_t offset_bytes) {
  glEnableVertexAttribArray(location);
  glVertexAttribPointer(location, components, GL_FLOAT, GL_FALSE, 0,
                        reinterpret_cast<const void*>(offset_bytes));
}

// Planes that hide less of an object than this do not, metres.
constexpr double kTouching = 1e-4;

double area_m2(const prt::Mesh& mesh) {
  double sum = 0;
  for (const auto& [a, b, c] : mesh.triangles)
    sum += glm::length(
        glm::cross(mesh.positions[b] - mesh.positions[a], mesh.positions[c] - mesh.positions[a]));
  return .5 * sum;
}

std::array<glm::dvec3, 8> corners_of(const prt::Bounds& bounds) {
  const glm::vec3 &a = bounds.low, &b = bounds.high;
  return {{{a.x, a.y, a.z},
           {b.x, a.y, a.z},
           {a.x, b.y, a.z},
           {b.x, b.y, a.z},
           {a.x, a.y, b.z},
           {b.x, a.y, b.z},
           {a.x, b.y, b.z},
           {b.x, b.y, b.z}}};
}

// At a vertex of the object's own, all but the edged light.
Rgb light_at(std::span<const float> relit, std::size_t stride, std::size_t vertex,
             const EdgedLight* edged) {
  Rgb out{relit[vertex], relit[stride + vertex], relit[2 * stride + vertex]};
  if (edged) out = out - edged->radiance * edged->cosine[vertex];
  for (int c = 0; c < 3; ++c) out[c] = std::max(out[c], 0.f);
  return out;
}

GLsizeiptr bytes_of(const auto& v) {
  return static_cast<GLsizeiptr>(v.size() * sizeof(v[0]));
}

}  // namespace

namespace {

GlTexture one_texel() {
  GlTexture texture;
  const std::uint8_t white[4] = {255, 255, 255, 255};
  glBindTexture(GL_TEXTURE_2D, texture.get());
  glTexStorage2D(GL_TEXTURE_2D, 1, GL_RGBA8, 1, 1);
  glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, 1, 1, GL_RGBA, GL_UNSIGNED_BYTE, white);
  return texture;
}

GlTexture albedo_texture(const Image<Rgb8>& picture) {
  GlTexture texture;
  glBindTexture(GL_TEXTURE_2D, texture.get());
  glTexStorage2D(GL_TEXTURE_2D, mip_levels(picture.width(), picture.height()), GL_SRGB8_ALPHA8,
                 picture.width(), picture.height());
  std::vector<std::uint8_t> codes;
  codes.reserve(4 * picture.area());
  for (const Rgb8& c : picture.pixels()) codes.insert(codes.end(), {c.r, c.g, c.b, 255});
  glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, picture.width(), picture.height(), GL_RGBA,
                  GL_UNSIGNED_BYTE, codes.data());
  glGenerateMipmap(GL_TEXTURE_2D);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_LINEAR_MIPMAP_LINEAR);
  return texture;
}

// Of more, four samples a pixel are drawn sooner than the contour is found.
constexpr std::size_t kMaxContourTriangles = 200'000;

}  // namespace

Result<Layers> Layers::create(int width, int height, int oversampling) {
  PENUMBRA_ASSIGN(programs, LayerPrograms::create());
  return Layers(width, height, oversampling, std::move(programs), one_texel());
}

// In the object's vertex array, as what follows.
void Layers::upload_coordinates(const DrawnObject& o, GLuint buffer, GLuint location,
                                std::span<const glm::vec2> coordinates) {
  if (coordinates.empty()) return;  // the attribute stays one constant place
  std::vector<glm::vec2> all(coordinates.begin(), coordinates.end());
  all.resize(o.albedo.size());  // points of a light map have none
  o.drawn_vertices.extend(all);
  glBindBuffer(GL_ARRAY_BUFFER, buffer);
  glBufferData(GL_ARRAY_BUFFER, bytes_of(all), all.data(), GL_STATIC_DRAW);
  attribute(location, 2, 0);
}

void Layers::add_pictures(DrawnObject& o, const prt::BakedObject& baked,
                          const Appearance& appearance) {
  if (!appearance.texture && appearance.texels.empty()) return;
  if (appearance.texture) {
    o.albedo.assign(baked.mesh.positions.size(), Rgb{1, 1, 1});
    std::ranges::copy(appearance.tint, o.albedo.begin());
    o.albedo_map = albedo_texture(*appearance.texture);
    upload_coordinates(o, o.texture_coordinates.get(), 2, appearance.texture_coordinates);
  } else {
    o.albedo_map = one_texel();
  }
  if (appearance.texels.empty()) return;
  LightMap map{.width = appearance.light_width,
               .height = appearance.light_height,
               .first = baked.mesh.positions.size() - appearance.texels.size()};
  for (const prt::SurfaceLayout::Texel& t : appearance.texels) map.places.push_back({t.x, t.y});
  map.pixels.resize(static_cast<std::size_t>(map.width) * static_cast<std::size_t>(map.height));
  glBindTexture(GL_TEXTURE_2D, map.texture.get());
  glTexStorage2D(GL_TEXTURE_2D, 1, GL_RGB16F, map.width, map.height);
  read_to_the_rim();
  upload_coordinates(o, o.light_coordinates.get(), 3, appearance.light_coordinates);
  // Light comes from the map; vertices tint it where a picture gives the albedo.
  o.colours.assign(baked.mesh.positions.size(), Rgb{1, 1, 1});
  if (appearance.texture) std::ranges::copy(appearance.tint, o.colours.begin());
  o.drawn_vertices.extend(o.colours);
  glBindBuffer(GL_ARRAY_BUFFER, o.light.get());
  glBufferSubData(GL_ARRAY_BUFFER, 0, bytes_of(o.colours), o.colours.data());
  o.light_map = std::move(map);
}

void Layers::fill_light_map(LightMap& map, std::span<const float> relit, std::size_t stride,
                            const std::vector<Rgb>& albedo) {
  for (std::size_t i = 0; i < map.places.size(); ++i) {
    const std::size_t point = map.first + i;
    const auto [x, y] = map.places[i];
    const Rgb lit{std::max(relit[point], 0.f), std::max(relit[stride + point], 0.f),
                  std::max(relit[2 * stride + point], 0.f)};
    map.pixels[static_cast<std::size_t>(y) * static_cast<std::size_t>(map.width) +
               static_cast<std::size_t>(x)] = albedo[point] * lit;
  }
  glBindTexture(GL_TEXTURE_2D, map.texture.get());
  glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, map.width, map.height, GL_RGB, GL_FLOAT,
                  map.pixels.data());
}

void Layers::use_lens(const ViewLens& lens) {
  max_edge_m_ = std::min(max_edge_m_, lens.max_edge_m());
}

EdgeMiddles Layers::refine(prt::Mesh& mesh) const {
  constexpr std::size_t kMaxTriangles = 150'000;
  if (!std::isfinite(max_edge_m_)) return {};
  return prt::subdivide(mesh, static_cast<float>(max_edge_m_), kMaxTriangles);
}

int Layers::add_object(const prt::BakedObject& baked, const Appearance& appearance) {
  const bool pictures = appearance.texture || !appearance.texels.empty();
  prt::Mesh mesh = baked.fine ? baked.fine->mesh : baked.mesh;
  const prt::Bounds bounds = bounds_of(mesh);
  DrawnVertices vertices(baked.fine, refine(mesh));
  DrawnObject o{.drawn_vertices = std::move(vertices),
                .triangles = mesh.triangles,
                .closed = is_closed(mesh),
                .albedo = baked.mesh.albedo,
                .colours = std::vector<Rgb>(mesh.positions.size()),
                .stride = baked.transfer.stride,
                .bounds = bounds,
                .area_m2 = area_m2(mesh)};
  const bool smooth = !fine_ && mesh.triangles.size() <= kMaxContourTriangles;
  if (smooth && !pictures && !baked.surface) o.contour.emplace(mesh);
  if (o.contour || baked.surface) o.positions = mesh.positions;
  glBindVertexArray(o.geometry.get());
  glBindBuffer(GL_ARRAY_BUFFER, o.vertices.get());
  glBufferData(GL_ARRAY_BUFFER, bytes_of(mesh.positions), mesh.positions.data(), GL_STATIC_DRAW);
  attribute(0, 3, 0);
  glBindBuffer(GL_ARRAY_BUFFER, o.light.get());
  glBufferData(GL_ARRAY_BUFFER, bytes_of(o.colours), o.colours.data(), GL_DYNAMIC_DRAW);
  attribute(1, 3, 0);
  if (baked.surface) {
    if (!glossy_) glossy_.emplace();
    if (surroundings_) glossy_->set_surroundings(*surroundings_);
    o.glossy = glossy_->add(baked, mesh, o.drawn_vertices, o.triangles);
    o.albedo.assign(baked.mesh.positions.size(), Rgb{1, 1, 1});
    mesh.triangles = o.triangles;
    if (smooth && !o.glossy->shows_backs) o.contour.emplace(mesh);  // all edges are triangles'
  } else if (baked.fine) {
    o.fine_albedo = mesh.albedo;
  }
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, o.indices.get());
  glBufferData(GL_ELEMENT_ARRAY_BUFFER, bytes_of(o.triangles), o.triangles.data(), GL_STATIC_DRAW);
  o.index_count = static_cast<GLsizei>(3 * o.triangles.size());
  if (!baked.surface) add_pictures(o, baked, appearance);
  glBindVertexArray(0);
  objects_.push_back(std::move(o));
  drawn_.reset();
  return static_cast<int>(objects_.size()) - 1;
}

void Layers::update_vertices(int object, const prt::Mesh& mesh) {
  DrawnObject& o = objects_[static_cast<std::size_t>(object)];
  o.bounds = bounds_of(mesh);
  const bool keeps = o.contour || o.glossy || !o.drawn_vertices.are_own();
  if (keeps) {
    o.positions = mesh.positions;
    o.drawn_vertices.extend(o.positions);
  }
  const std::vector<glm::vec3>& positions = keeps ? o.positions : mesh.positions;
  glBindBuffer(GL_ARRAY_BUFFER, o.vertices.get());
  glBufferSubData(GL_ARRAY_BUFFER, 0, bytes_of(positions), positions.data());
  if (o.glossy) {
    std::vector<glm::vec3> normals = mesh.normals;
    o.drawn_vertices.extend(normals);
    Glossy::update_normals(*o.glossy, normals);
  }
  o.changed = true;
  o.contour_known = false;
}

void Layers::set_pose(int object, const Pose& world_from_bake, const Pose& world_from_floor) {
  DrawnObject& o = objects_[static_cast<std::size_t>(object)];
  if (o.world_from_bake == world_from_bake && o.world_from_floor == world_from_floor) return;
  o.world_from_bake = world_from_bake;
  o.world_from_floor = world_from_floor;
  o.changed = true;
  o.contour_known = false;
}

void Layers::show(int object, bool visible) {
  DrawnObject& o = objects_[static_cast<std::size_t>(object)];
  if (std::exchange(o.visible, visible) != visible) o.changed = true;
}

void Layers::set_light(int object, std::span<const float> relit, const EdgedLight* edged) {
  DrawnObject& o = objects_[static_cast<std::size_t>(object)];
  if (o.light_map) {
    fill_light_map(*o.light_map, relit, o.stride, o.albedo);
    o.changed = true;
    return;
  }
  o.changed |= o.edged.set(edged, o.albedo, o.fine_albedo, o.drawn_vertices, o.geometry);
  if (o.glossy) o.glossy->edged_towards = edged ? edged->direction : glm::dvec3(0);
  if (o.drawn_vertices.fine()) return set_fine_light(o, relit, edged);
  bool changed = false;
  const std::size_t own = o.albedo.size(), all = o.colours.size();
  for (std::size_t i = 0; i < own; ++i) {
    const Rgb colour = o.albedo[i] * light_at(relit, o.stride, i, edged);
    changed |= !(colour == o.colours[i]);
    o.colours[i] = colour;
  }
  if (!changed) return;  // a shadow moved, or a neighbour
  if (all > own) {
    o.colours.resize(own);
    o.drawn_vertices.extend(o.colours);
  }
  glBindBuffer(GL_ARRAY_BUFFER, o.light.get());
  glBufferSubData(GL_ARRAY_BUFFER, 0, bytes_of(o.colours), o.colours.data());
  o.changed = true;
}

void Layers::set_fine_light(DrawnObject& o, std::span<const float> relit, const EdgedLight* edged) {
  std::vector<Rgb> lit(o.albedo.size());
  for (std::size_t i = 0; i < lit.size(); ++i) lit[i] = light_at(relit, o.stride, i, edged);
  if (lit == o.lit) return;
  o.lit = std::move(lit);
  o.colours = o.lit;
  o.drawn_vertices.spread(o.colours);
  for (std::size_t i = 0; i < o.fine_albedo.size(); ++i)
    o.colours[i] = o.fine_albedo[i] * o.colours[i];
  glBindBuffer(GL_ARRAY_BUFFER, o.light.get());
  glBufferSubData(GL_ARRAY_BUFFER, 0, bytes_of(o.colours), o.colours.data());
  o.changed = true;
}

Layers::Occluder Layers::upload(const prt::Mesh& mesh) {
  Occluder o;
  o.index_count = static_cast<GLsizei>(mesh.triangles.size() * 3);
  glBindVertexArray(o.geometry.get());
  glBindBuffer(GL_ARRAY_BUFFER, o.vertices.get());
  glBufferData(GL_ARRAY_BUFFER, bytes_of(mesh.positions), mesh.positions.data(), GL_STATIC_DRAW);
  attribute(0, 3, 0);
  // Nothing taken until set_ratios says otherwise; zeros stay zeros under interpolation.
  const std::vector<float> zeros(3 * mesh.positions.size(), 0.f);
  glBindBuffer(GL_ARRAY_BUFFER, o.deficits.get());
  glBufferData(GL_ARRAY_BUFFER, bytes_of(zeros), zeros.data(), GL_DYNAMIC_DRAW);
  attribute(1, 3, 0);
  const std::vector<float> ones(3 * mesh.positions.size(), 1.f);
  glBindBuffer(GL_ARRAY_BUFFER, o.weights.get());
  glBufferData(GL_ARRAY_BUFFER, bytes_of(ones), ones.data(), GL_DYNAMIC_DRAW);
  attribute(2, 3, 0);
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, o.indices.get());
  glBufferData(GL_ELEMENT_ARRAY_BUFFER, bytes_of(mesh.triangles), mesh.triangles.data(),
               GL_STATIC_DRAW);
  glBindVertexArray(0);
  return o;
}

int Layers::add_occluder(const prt::Mesh& mesh) {
  prt::Mesh fine = mesh;
  DrawnVertices vertices(nullptr, refine(fine));
  occluders_.push_back(upload(fine));
  occluder_meshes_.push_back({std::move(vertices), mesh.positions, mesh.triangles, {}});
  drawn_.reset();
  return static_cast<int>(occluders_.size()) - 1;
}

void Layers::upload_by_vertex(std::size_t occluder, const GlBuffer& buffer,
                              std::vector<Rgb> values) {
  occluder_meshes_[occluder].drawn_vertices.extend(values);
  glBindBuffer(GL_ARRAY_BUFFER, buffer.get());
  glBufferSubData(GL_ARRAY_BUFFER, 0, bytes_of(values), values.data());
  drawn_.reset();
}

void Layers::set_weights(int occluder, std::span<const Rgb> weights) {
  const auto index = static_cast<std::size_t>(occluder);
  upload_by_vertex(index, occluders_[index].weights, {weights.begin(), weights.end()});
}

void Layers::set_ratios(int occluder, std::span<const Rgb> ratios) {
  const auto index = static_cast<std::size_t>(occluder);
  std::vector<Rgb> deficits;
  for (const Rgb& s : ratios) deficits.push_back({1 - s.r, 1 - s.g, 1 - s.b});
  upload_by_vertex(index, occluders_[index].deficits, std::move(deficits));
  OccluderMesh& mesh = occluder_meshes_[index];
  const Rgb open{1, 1, 1};
  std::optional<prt::Bounds> shaded;
  for (const auto& t : mesh.triangles) {
    if (ratios[t[0]] == open && ratios[t[1]] == open && ratios[t[2]] == open) continue;
    for (const std::uint32_t v : t) {
      const glm::vec3& p = mesh.positions[v];
      shaded = shaded ? prt::Bounds{glm::min(shaded->low, p), glm::max(shaded->high, p)}
                      : prt::Bounds{p, p};
    }
  }
  mesh.shaded = shaded;
}

void Layers::add_plane(const glm::dvec3& point, const glm::dvec3& normal) {
  constexpr double kHalfSide = 300;  // metres; beyond, nothing of an object could be told apart
  const glm::dvec3 u = glm::normalize(
      glm::cross(normal, std::abs(normal.y) < .9 ? glm::dvec3(0, 1, 0) : glm::dvec3(1, 0, 0)));
  const glm::dvec3 v = glm::cross(normal, u);
  prt::Mesh quad;
  for (const auto& [a, b] : {std::pair{-1., -1.}, {1., -1.}, {1., 1.}, {-1., 1.}})
    quad.positions.emplace_back(point + kHalfSide * (a * u + b * v));
  quad.triangles = {{0, 1, 2}, {0, 2, 3}};
  planes_.push_back({point, normal, upload(quad)});
  drawn_.reset();
}

namespace {

// Real geometry lies a little further away, so that it never hides what rests on it.
class PushedBack {
 public:
  PushedBack() {
    glEnable(GL_POLYGON_OFFSET_FILL);
    glPolygonOffset(1, 4);
  }
  ~PushedBack() { glDisable(GL_POLYGON_OFFSET_FILL); }
};

}  // namespace

void Layers::draw_occluders(const ViewProjection& from_world) {
  const PushedBack state;
  programs_.use(LayerDrawing::kRealMesh, from_world, true);
  for (const Occluder& o : occluders_) {
    glBindVertexArray(o.geometry.get());
    glDrawElements(GL_TRIANGLES, o.index_count, GL_UNSIGNED_INT, nullptr);
  }
}

void Layers::draw_hiding_planes(const glm::dvec3& eye, const ViewProjection& from_world) {
  const PushedBack state;
  programs_.use(LayerDrawing::kRealMesh, from_world, true);
  for (const DrawnPlane& p : planes_) {
    if (std::ranges::none_of(objects_, [&](const DrawnObject& o) {
          return o.visible && hidden_m(p, o, eye) > kTouching;
        }))
      continue;
    glBindVertexArray(p.quad.geometry.get());
    glDrawElements(GL_TRIANGLES, p.quad.index_count, GL_UNSIGNED_INT, nullptr);
  }
}

// Those that hide a part of the object, in the frame of the camera, a little behind where they are,
// as PushedBack has it.
std::vector<glm::dvec4> Layers::hiding_planes(const DrawnObject& o,
                                              const prt::PinholeView& camera) const {
  std::vector<glm::dvec4> out;
  const glm::dvec3& eye = camera.world_from_camera.translation;
  for (const DrawnPlane& p : planes_) {
    if (!(hidden_m(p, o, eye) > kTouching)) continue;
    const glm::dvec3 normal = glm::conjugate(camera.world_from_camera.rotation) * p.normal;
    out.emplace_back(normal, glm::dot(p.normal, eye - p.point) + kTouching);
  }
  return out;
}

void Layers::bind_pictures(const DrawnObject& o, GLuint program) const {
  glActiveTexture(GL_TEXTURE1);
  glBindTexture(GL_TEXTURE_2D, o.light_map ? o.light_map->texture.get() : white_.get());
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, o.albedo_map->get());
  glUniform1i(glGetUniformLocation(program, "albedo_map"), 0);
  glUniform1i(glGetUniformLocation(program, "light_map"), 1);
}

void Layers::set_surroundings(const Surroundings& surroundings) {
  surroundings_ = surroundings;
  if (!glossy_) return;
  glossy_->set_surroundings(surroundings);
  for (DrawnObject& o : objects_) o.changed |= o.glossy.has_value();
}

void Layers::set_light_fractions(int object, std::span<const std::array<float, 4>> fractions) {
  DrawnObject& o = objects_[static_cast<std::size_t>(object)];
  if (!o.glossy) return;
  Glossy::set_fractions(*o.glossy, fractions, o.drawn_vertices);
  o.changed = true;
}

void Layers::set_floor(int object, const Image<Rgb>& ratios) {
  DrawnObject& o = objects_[static_cast<std::size_t>(object)];
  if (Glossy::set_floor(*o.glossy, ratios)) o.changed = true;
}

void Layers::set_mirrored(int object, const MirroredPicture& picture) {
  DrawnObject& o = objects_[static_cast<std::size_t>(object)];
  if (!o.glossy) return;
  Glossy::set_mirrored(*o.glossy, picture);
  o.changed = true;
}

GLuint Layers::use_program(const View& view, const ViewProjection& from_world, const DrawnObject& o,
                           std::optional<GlossyFeatures> glossy) const {
  const LayerDrawing drawing = o.albedo_map ? LayerDrawing::kTexturedObject : LayerDrawing::kObject;
  const ViewProjection from_object = from_world.of(o.world_from_bake);
  const std::vector<glm::dvec4> planes =
      view.lens ? hiding_planes(o, view.camera) : std::vector<glm::dvec4>();
  const bool cut = !planes.empty() || from_object.may_cut(corners_of(o.bounds));
  const GLuint program = glossy ? programs_.use_glossy(*glossy, from_object, cut)
                                : programs_.use(drawing, from_object, cut);
  if (view.lens && cut) programs_.set_hiding_planes(program, planes);
  glUniform1f(glGetUniformLocation(program, "signal_per_radiance"), view.signal_per_radiance);
  return program;
}

Result<void> Layers::prepare_programs(const View& view) {
  PENUMBRA_TRY(programs_.prepare(view.lens, view.foreground));
  for (const DrawnObject& o : objects_)
    if (o.glossy)
      for (const GlossyObject::Part& part : o.glossy->parts)
        PENUMBRA_TRY(programs_.prepare_glossy(glossy_->features_of(*o.glossy, part)));
  return {};
}

void Layers::draw_objects(const View& view, const ViewProjection& from_world, const Rect& region,
                          bool seen_alone) {
  EdgedVertices::draw_without();
  for (DrawnObject& o : objects_) {
    if (o.glossy || !o.visible || !meet(reach_of(o, from_world), region)) continue;
    const GLuint program = use_program(view, from_world, o);
    if (o.albedo_map) bind_pictures(o, program);
    if (fronts_only(o, view.camera.world_from_camera.translation)) glEnable(GL_CULL_FACE);
    glBindVertexArray(o.geometry.get());
    glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, (seen_alone ? o.seen : o.indices).get());
    glDrawElements(GL_TRIANGLES, seen_alone ? o.seen_count : o.index_count, GL_UNSIGNED_INT,
                   nullptr);
    glDisable(GL_CULL_FACE);
  }
}

// Farthest objects first, so that what is blended lies over what is behind it.
void Layers::draw_glossy(const View& view, const ViewProjection& from_world, const Rect& region,
                         bool seen_alone, bool blended) {
  const glm::dvec3& eye = view.camera.world_from_camera.translation;
  std::vector<DrawnObject*> order;
  for (DrawnObject& o : objects_)
    if (o.glossy && o.visible && o.glossy->any(blended) && meet(reach_of(o, from_world), region))
      order.push_back(&o);
  std::ranges::sort(order, std::greater(),
                    [&](const DrawnObject* o) { return distance_to_box(*o, eye); });
  for (DrawnObject* const o : order) {
    const auto use = [&](GlossyFeatures features) {
      return use_program(view, from_world, *o, features);
    };
    glBindVertexArray(o->geometry.get());
    const auto triangles = seen_alone ? o->contour->seen() : std::span(o->triangles);
    const auto parts = seen_alone ? o->glossy->parts_of(triangles) : o->glossy->parts;
    glossy_->draw(*o->glossy, use,
                  {o->world_from_bake, o->world_from_floor, eye, fronts_only(*o, eye),
                   (seen_alone ? o->seen : o->indices).get(), triangles, parts, o->positions},
                  blended);
  }
}

Rect Layers::reach_of(const ViewProjection& from_bounds, const prt::Bounds& bounds) {
  return from_bounds.reach(corners_of(bounds));
}

// Nothing of one that is not shown.
Rect Layers::reach_of(const DrawnObject& o, const ViewProjection& from_world) {
  return o.visible ? reach_of(from_world.of(o.world_from_bake), o.bounds) : Rect{};
}

Rect Layers::reach_of_objects(const ViewProjection& from_world) const {
  Rect out;
  for (const DrawnObject& o : objects_) out = united(out, reach_of(o, from_world));
  return out;
}

// Where several samples a pixel are taken: of programs that take long not all are shaded.
Canvas& Layers::canvas_of_samples(const ViewProjection& from_world) {
  const bool glossy = std::ranges::any_of(
      objects_, [&](const DrawnObject& o) { return o.glossy && in_view(o, from_world); });
  return glossy && !fine_ ? glossy_canvas_ : objects_canvas_;
}

// True where one sample a pixel did.
Result<bool> Layers::draw_layer_of_objects(const View& view, const ViewProjection& from_world,
                                           Layer& out) {
  out.rect = reach_of_objects(from_world);
  if (out.rect.empty()) return false;
  if (one_sample_does(view.camera, from_world) && find_contours(view, from_world, out.rect)) {
    PENUMBRA_TRY(draw_on(plain_canvas_, view, from_world, out));
    if (smoother_.smooth(lines_, out)) return true;
  }
  PENUMBRA_TRY(draw_on(canvas_of_samples(from_world), view, from_world, out));
  return false;
}

Result<void> Layers::begin(Canvas& canvas, const Rect& rect) {
  programs_.place_foreground(rect, canvas.oversampling());
  if (glossy_) glossy_->place(rect, canvas.oversampling());
  return canvas.begin(rect, width_, height_);
}

Result<void> Layers::draw_on(Canvas& canvas, const View& view, const ViewProjection& from_world,
                             Layer& out) {
  PENUMBRA_TRY(begin(canvas, out.rect));
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  draw_occluders(from_world);
  if (!view.lens) draw_hiding_planes(view.camera.world_from_camera.translation, from_world);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  draw_objects(view, from_world, out.rect, &canvas == &plain_canvas_);
  for (const bool blended : {false, true})
    draw_glossy(view, from_world, out.rect, &canvas == &plain_canvas_, blended);
  canvas.finish(out);
  return {};
}

namespace {

Result<void> check_gl() {
  constexpr GLenum kContextLost = 0x0507;  // OpenGL ES 3.2
  const GLenum error = glGetError();
  if (error == GL_NO_ERROR) return {};
  if (error == kContextLost)
    return fail(ErrorCode::kUnavailable, "GL", "the context is lost: the driver has begun anew");
  return fail(ErrorCode::kUnavailable, "GL", fmt::format("error 0x{:04x} while drawing", error));
}

}  // namespace

Result<void> Layers::draw(const View& view, const Rect& receiver_area, CommonLayer& objects_layer,
                          CommonLayer& hidden_layer) {
  // A camera on a tripod: what unchanged objects in unchanged light show still holds.
  PENUMBRA_TRY(prepare_programs(view));
  if (drawn_ && drawn_->shows(view, receiver_area, has_occluders())) {
    PENUMBRA_ASSIGN(done, redraw_changed(view, objects_layer));
    if (done) {
      const auto drawn = check_gl();
      if (!drawn) drawn_.reset();
      return drawn;
    }
  }
  drawn_.reset();
  Layer &objects = objects_layer.renewed(), &hidden = hidden_layer.renewed();
  const ViewProjection from_world(view.camera, view.lens.get());
  PENUMBRA_ASSIGN(by_contours, draw_layer_of_objects(view, from_world, objects));
  hidden.rect = occluders_.empty() ? Rect{} : receiver_area;
  for (const OccluderMesh& mesh : occluder_meshes_)
    if (mesh.shaded) hidden.rect = united(hidden.rect, reach_of(from_world, *mesh.shaded));
  if (!hidden.rect.empty()) {
    PENUMBRA_TRY(begin(hidden_canvas_, hidden.rect));
    draw_occluders(from_world);
    hidden_canvas_.finish(hidden);
  }
  PENUMBRA_TRY(check_gl());
  keep_as_drawn(from_world);
  drawn_ = DrawnLayers{view, receiver_area, by_contours};
  return {};
}

}  // namespace penumbra::compositor
