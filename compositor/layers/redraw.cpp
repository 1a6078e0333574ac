// Before a camera that stands, what changed is drawn anew: an object that moves costs nothing of
// those that rest.
#include <algorithm>
#include <utility>

#include "compositor/layers/layers.h"

namespace penumbra::compositor {

namespace {

// Smoothed contours give pixels to their neighbours.
constexpr int kSmoothed_px = 1;
// Of the whole layer: from there on a part is no less work.
constexpr double kMaxPart = .6;

double area_of(const Rect& r) {
  return double(r.width()) * double(r.height());
}

Rect grown(const Rect& r, int by, int width, int height) {
  return common({r.x0 - by, r.y0 - by, r.x1 + by, r.y1 + by}, {0, 0, width, height});
}

void copy(const Layer& from, const Rect& region, Layer& to) {
  const Rect here = common(common(from.rect, region), to.rect);
  if (here.empty()) return;
  const auto width = static_cast<std::size_t>(to.rect.width());
  for (int y = here.y0; y < here.y1; ++y) {
    const auto row = from.row(y).subspan(4 * static_cast<std::size_t>(here.x0 - from.rect.x0),
                                         4 * static_cast<std::size_t>(here.width()));
    std::ranges::copy(
        row, to.halves.begin() +
                 static_cast<std::ptrdiff_t>(4 * (static_cast<std::size_t>(y - to.rect.y0) * width +
                                                  static_cast<std::size_t>(here.x0 - to.rect.x0))));
  }
}

// The layer with another rectangle and other contents in the region.
void replace(const Layer& part, const Rect& region, const Rect& whole, CommonLayer& layer) {
  if (layer.now.use_count() > 1 || layer.now->rect != whole) {
    const std::shared_ptr<Layer> before = layer.now;
    Layer& next = layer.renewed();
    next.rect = whole;
    next.halves.assign(
        static_cast<std::size_t>(whole.width()) * static_cast<std::size_t>(whole.height()) * 4, 0);
    copy(*before, before->rect, next);
    if (!layer.spare) layer.spare = before;
  }
  copy(part, region, *layer.now);
}

}  // namespace

// What changed objects could and can reach.
Rect Layers::changed_region(const ViewProjection& from_world) const {
  Rect out;
  for (const DrawnObject& o : objects_)
    if (o.changed) out = united(out, united(o.drawn_at, reach_of(o, from_world)));
  return out;
}

void Layers::keep_as_drawn(const ViewProjection& from_world) {
  for (DrawnObject& o : objects_) {
    o.changed = false;
    o.drawn_at = reach_of(o, from_world);
  }
}

// False where all has to be drawn.
Result<bool> Layers::redraw_changed(const View& view, CommonLayer& objects) {
  if (std::ranges::none_of(objects_, &DrawnObject::changed)) return true;
  const ViewProjection from_world(view.camera, view.lens.get());
  const Rect whole = reach_of_objects(from_world), changed = changed_region(from_world);
  if (changed.empty() && objects.now->rect == whole) {  // out of the picture
    keep_as_drawn(from_world);
    return true;
  }
  // A smoothed pixel needs both of its neighbours.
  const Rect kept = grown(changed, kSmoothed_px, width_, height_);
  part_.rect = grown(changed, 2 * kSmoothed_px, width_, height_);
  if (whole.empty() || part_.rect.empty() || area_of(part_.rect) > kMaxPart * area_of(whole) ||
      drawn_->by_contours != one_sample_does(view.camera, from_world))
    return false;
  if (drawn_->by_contours) {
    if (!find_contours(view, from_world, part_.rect)) return false;
    PENUMBRA_TRY(draw_on(plain_canvas_, view, from_world, part_));
    if (!smoother_.smooth(lines_, part_)) return false;
  } else {
    PENUMBRA_TRY(draw_on(canvas_of_samples(from_world), view, from_world, part_));
  }
  replace(part_, kept, whole, objects);
  keep_as_drawn(from_world);
  return true;
}

}  // namespace penumbra::compositor
