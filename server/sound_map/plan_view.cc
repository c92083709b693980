#include "sound_map/plan_view.h"

#include <cairo.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/time/time.h"
#include "sound_map/color_map.h"

namespace soundmap::sound_map {
namespace {

constexpr double kMarginLeft = 78.0;
constexpr double kMarginTop = 92.0;
constexpr double kMarginBottom = 74.0;
constexpr double kPanelGap = 44.0;
constexpr double kPanelWidth = 360.0;
constexpr double kMinPlotHeight = 560.0;
constexpr double kRowHeight = 23.0;
constexpr double kBarHeight = 240.0;
constexpr int kMaxRows = 40;
constexpr int kMaxImageSide = 8192;
constexpr double kMarginAround_m = 0.25;

using Surface = std::unique_ptr<cairo_surface_t, decltype(&cairo_surface_destroy)>;
using Context = std::unique_ptr<cairo_t, decltype(&cairo_destroy)>;

struct Rgb {
  double red, green, blue;
};
constexpr Rgb kInk{0.13, 0.16, 0.20};
constexpr Rgb kSoftInk{0.42, 0.46, 0.51};
constexpr Rgb kUnknown{0.925, 0.933, 0.941};
constexpr Rgb kWall{0.20, 0.24, 0.29};
constexpr Rgb kFrame{0.70, 0.73, 0.76};
constexpr Rgb kWhite{1.0, 1.0, 1.0};

void SetColor(cairo_t* cr, const Rgb& color, double alpha = 1.0) {
  cairo_set_source_rgba(cr, color.red, color.green, color.blue, alpha);
}

enum class Align { kLeft, kCentre, kRight };

void DrawText(cairo_t* cr, const std::string& text, double x, double y, double size, Align align,
              bool bold = false, const Rgb& color = kInk) {
  cairo_select_font_face(cr, "DejaVu Sans", CAIRO_FONT_SLANT_NORMAL,
                         bold ? CAIRO_FONT_WEIGHT_BOLD : CAIRO_FONT_WEIGHT_NORMAL);
  cairo_set_font_size(cr, size);
  cairo_text_extents_t extents;
  cairo_text_extents(cr, text.c_str(), &extents);
  const double shift = align == Align::kLeft     ? 0.0
                       : align == Align::kCentre ? 0.5 * extents.x_advance
                                                 : extents.x_advance;
  SetColor(cr, color);
  cairo_move_to(cr, x - shift, y);
  cairo_show_text(cr, text.c_str());
}

// 1, 2 or 5 times a power of ten, so that about `count` steps make the length.
double NiceStep(double length, double count) {
  const double raw = length / count;
  const double power = std::pow(10.0, std::floor(std::log10(raw)));
  const double factor = raw / power;
  return power * (factor <= 1.0 ? 1.0 : factor <= 2.0 ? 2.0 : factor <= 5.0 ? 5.0 : 10.0);
}

std::string FormatLength(double length_m) {
  return length_m < 1.0 ? absl::StrFormat("%.0f cm", 100.0 * length_m)
                        : absl::StrFormat("%g m", length_m);
}

// What the picture shows, and where on the page.
struct View {
  double min_x_m = std::numeric_limits<double>::infinity();
  double min_y_m = min_x_m;
  double max_x_m = -min_x_m;
  double max_y_m = -min_x_m;
  double pixels_per_m = 1.0;
  double width = 0.0;
  double height = 0.0;
  double left = kMarginLeft;
  double top = kMarginTop;

  bool empty() const { return !(min_x_m <= max_x_m); }
  void Include(double x_m, double y_m) {
    min_x_m = std::min(min_x_m, x_m);
    max_x_m = std::max(max_x_m, x_m);
    min_y_m = std::min(min_y_m, y_m);
    max_y_m = std::max(max_y_m, y_m);
  }
  double PageX(double x_m) const { return left + (x_m - min_x_m) * pixels_per_m; }
  double PageY(double y_m) const { return top + (max_y_m - y_m) * pixels_per_m; }
};

// A grid of cells over the plan, coarser than the map where that would make too large an image.
struct Raster {
  int width = 0;
  int height = 0;
  double cell_size_m = 0.0;
  double min_x_m = 0.0;
  double max_y_m = 0.0;
  std::vector<std::uint32_t> argb;  // premultiplied, row 0 on top

  static Raster Over(const View& view, double cell_size_m) {
    Raster raster;
    const double longest_m = std::max(view.max_x_m - view.min_x_m, view.max_y_m - view.min_y_m);
    // Whole multiples, so that cells of the map do not fall between cells of the image.
    raster.cell_size_m =
        cell_size_m * std::max(1.0, std::ceil(longest_m / cell_size_m / kMaxImageSide));
    raster.min_x_m = std::floor(view.min_x_m / cell_size_m) * cell_size_m;
    raster.max_y_m = std::ceil(view.max_y_m / cell_size_m) * cell_size_m;
    raster.width = static_cast<int>((view.max_x_m - raster.min_x_m) / raster.cell_size_m) + 1;
    raster.height = static_cast<int>((raster.max_y_m - view.min_y_m) / raster.cell_size_m) + 1;
    raster.argb.assign(static_cast<std::size_t>(raster.width) * raster.height, 0);
    return raster;
  }
  // Index of the cell around a point, -1 outside.
  std::ptrdiff_t IndexOf(double x_m, double y_m) const {
    const double column = std::floor((x_m - min_x_m) / cell_size_m);
    const double row = std::floor((max_y_m - y_m) / cell_size_m);
    if (!(column >= 0 && row >= 0 && column < width && row < height)) return -1;
    return static_cast<std::ptrdiff_t>(row) * width + static_cast<std::ptrdiff_t>(column);
  }
  void Draw(cairo_t* cr, const View& view) {
    const Surface image(
        cairo_image_surface_create_for_data(reinterpret_cast<unsigned char*>(argb.data()),
                                            CAIRO_FORMAT_ARGB32, width, height, width * 4),
        &cairo_surface_destroy);
    cairo_save(cr);
    cairo_rectangle(cr, view.left, view.top, view.width, view.height);
    cairo_clip(cr);
    cairo_translate(cr, view.PageX(min_x_m), view.PageY(max_y_m));
    cairo_scale(cr, cell_size_m * view.pixels_per_m, cell_size_m * view.pixels_per_m);
    cairo_set_source_surface(cr, image.get(), 0, 0);
    cairo_pattern_set_filter(cairo_get_source(cr), CAIRO_FILTER_NEAREST);
    cairo_paint(cr);
    cairo_restore(cr);
  }
};

std::uint32_t Argb(double red, double green, double blue, double alpha) {
  const auto byte = [](double value) {
    return static_cast<std::uint32_t>(std::lround(255.0 * std::clamp(value, 0.0, 1.0)));
  };
  return byte(alpha) << 24 | byte(red * alpha) << 16 | byte(green * alpha) << 8 |
         byte(blue * alpha);
}

template <typename Visit>
void ForEachCell(const PlanImage& plan, std::uint8_t kind, Visit visit) {
  for (int row = 0; row < plan.height; ++row) {
    for (int column = 0; column < plan.width; ++column) {
      if (plan.cells[static_cast<std::size_t>(row) * plan.width + column] != kind) continue;
      visit(plan.origin_in_map_m.x() + (column + 0.5) * plan.cell_size_m,
            plan.origin_in_map_m.y() + (row + 0.5) * plan.cell_size_m);
    }
  }
}

View FitView(const Snapshot& snapshot, const std::optional<PlanImage>& plan,
             std::span<const SoundSource> sources, const PlanViewOptions& options) {
  View view;
  if (plan) {
    for (const std::uint8_t kind : {1, 2}) {
      ForEachCell(*plan, kind, [&](double x_m, double y_m) { view.Include(x_m, y_m); });
    }
  }
  snapshot.ForEach([&](const geometry::VoxelKey& key, const Voxel& voxel) {
    if (voxel.update_count > options.min_updates) {
      const Eigen::Vector3d centre = geometry::PointFromKey(key, snapshot.voxel_size_m());
      view.Include(centre.x(), centre.y());
    }
    return true;
  });
  for (const SoundSource& source : sources) {
    if (source.position_in_map_m.allFinite()) {
      view.Include(source.position_in_map_m.x(), source.position_in_map_m.y());
    }
  }
  if (view.empty()) {
    view.Include(-1.0, -1.0);
    view.Include(1.0, 1.0);
  }
  view.min_x_m -= kMarginAround_m;
  view.min_y_m -= kMarginAround_m;
  view.max_x_m += kMarginAround_m;
  view.max_y_m += kMarginAround_m;
  const double longest_m = std::max(view.max_x_m - view.min_x_m, view.max_y_m - view.min_y_m);
  view.pixels_per_m = std::min(std::clamp(options.max_plot_pixels, 200, 8000) / longest_m, 400.0);
  view.width = (view.max_x_m - view.min_x_m) * view.pixels_per_m;
  view.height = (view.max_y_m - view.min_y_m) * view.pixels_per_m;
  return view;
}

void DrawPlan(cairo_t* cr, const View& view, const PlanImage& plan, bool walls_only) {
  Raster raster = Raster::Over(view, plan.cell_size_m);
  if (!walls_only) {
    ForEachCell(plan, 1, [&](double x_m, double y_m) {
      const auto index = raster.IndexOf(x_m, y_m);
      if (index >= 0) raster.argb[index] = Argb(1.0, 1.0, 1.0, 1.0);
    });
  }
  const double alpha = walls_only ? 0.55 : 1.0;
  ForEachCell(plan, 2, [&](double x_m, double y_m) {
    const auto index = raster.IndexOf(x_m, y_m);
    if (index >= 0) raster.argb[index] = Argb(kWall.red, kWall.green, kWall.blue, alpha);
  });
  raster.Draw(cr, view);
}

void DrawSound(cairo_t* cr, const View& view, const Snapshot& snapshot,
               const PlanViewOptions& options) {
  Raster raster = Raster::Over(view, snapshot.voxel_size_m());
  constexpr float kNone = -std::numeric_limits<float>::infinity();
  std::vector<float> column_max(raster.argb.size(), kNone);
  snapshot.ForEach([&](const geometry::VoxelKey& key, const Voxel& voxel) {
    if (voxel.update_count <= options.min_updates) return true;
    const Eigen::Vector3d centre = geometry::PointFromKey(key, snapshot.voxel_size_m());
    const auto index = raster.IndexOf(centre.x(), centre.y());
    if (index >= 0) column_max[index] = std::max(column_max[index], voxel.log_odds);
    return true;
  });
  for (std::size_t i = 0; i < column_max.size(); ++i) {
    if (column_max[i] == kNone) continue;
    const Color color = ColorOfLogOdds(column_max[i]);
    raster.argb[i] = Argb(color.red / 255.0, color.green / 255.0, color.blue / 255.0, 0.94);
  }
  raster.Draw(cr, view);
}

void DrawAxes(cairo_t* cr, const View& view) {
  cairo_set_line_width(cr, 1.0);
  SetColor(cr, kFrame);
  cairo_rectangle(cr, view.left - 0.5, view.top - 0.5, view.width + 1.0, view.height + 1.0);
  cairo_stroke(cr);
  const double step_m = NiceStep(std::max(view.width, view.height) / view.pixels_per_m,
                                 std::max(view.width, view.height) / 110.0);
  const double bottom = view.top + view.height;
  const auto label = [&](double value_m) {
    return absl::StrFormat("%g", std::abs(value_m) < 1e-9 ? 0.0 : value_m);
  };
  for (double i = std::ceil(view.min_x_m / step_m); i * step_m <= view.max_x_m; ++i) {
    const double x = std::round(view.PageX(i * step_m)) + 0.5;
    SetColor(cr, kInk, 0.07);
    cairo_move_to(cr, x, view.top);
    cairo_line_to(cr, x, bottom);
    cairo_stroke(cr);
    SetColor(cr, kSoftInk);
    cairo_move_to(cr, x, bottom);
    cairo_line_to(cr, x, bottom + 6.0);
    cairo_stroke(cr);
    DrawText(cr, label(i * step_m), x, bottom + 21.0, 13.0, Align::kCentre, false, kSoftInk);
  }
  for (double i = std::ceil(view.min_y_m / step_m); i * step_m <= view.max_y_m; ++i) {
    const double y = std::round(view.PageY(i * step_m)) + 0.5;
    SetColor(cr, kInk, 0.07);
    cairo_move_to(cr, view.left, y);
    cairo_line_to(cr, view.left + view.width, y);
    cairo_stroke(cr);
    SetColor(cr, kSoftInk);
    cairo_move_to(cr, view.left - 6.0, y);
    cairo_line_to(cr, view.left, y);
    cairo_stroke(cr);
    DrawText(cr, label(i * step_m), view.left - 11.0, y + 4.5, 13.0, Align::kRight, false,
             kSoftInk);
  }
  DrawText(cr, "x [m]", view.left + 0.5 * view.width, bottom + 46.0, 14.0, Align::kCentre);
  cairo_save(cr);
  cairo_translate(cr, view.left - 52.0, view.top + 0.5 * view.height);
  cairo_rotate(cr, -0.5 * 3.14159265358979);
  DrawText(cr, "y [m]", 0.0, 0.0, 14.0, Align::kCentre);
  cairo_restore(cr);
}

void DrawScaleBar(cairo_t* cr, const View& view) {
  const double length_m = NiceStep(view.width / view.pixels_per_m, 5.0);
  const double length = length_m * view.pixels_per_m;
  const double x = view.left + view.width - length - 24.0;
  const double y = view.top + view.height - 26.0;
  SetColor(cr, kWhite, 0.88);
  cairo_rectangle(cr, x - 12.0, y - 24.0, length + 24.0, 40.0);
  cairo_fill(cr);
  for (int half = 0; half < 2; ++half) {
    SetColor(cr, half == 0 ? kInk : kWhite);
    cairo_rectangle(cr, x + half * 0.5 * length, y, 0.5 * length, 6.0);
    cairo_fill(cr);
  }
  SetColor(cr, kInk);
  cairo_set_line_width(cr, 1.0);
  cairo_rectangle(cr, x, y, length, 6.0);
  cairo_stroke(cr);
  DrawText(cr, FormatLength(length_m), x + 0.5 * length, y - 7.0, 13.0, Align::kCentre);
}

void DrawBadge(cairo_t* cr, double x, double y, const std::string& text) {
  cairo_new_path(cr);
  cairo_arc(cr, x, y, 11.0, 0.0, 2.0 * 3.14159265358979);
  SetColor(cr, kInk);
  cairo_fill_preserve(cr);
  SetColor(cr, kWhite);
  cairo_set_line_width(cr, 2.0);
  cairo_stroke(cr);
  DrawText(cr, text, x, y + 4.3, text.size() > 2 ? 9.5 : 12.0, Align::kCentre, true, kWhite);
}

void DrawSources(cairo_t* cr, const View& view, std::span<const SoundSource> sources) {
  for (std::size_t i = sources.size(); i-- > 0;) {
    const double x = view.PageX(sources[i].position_in_map_m.x());
    const double y = view.PageY(sources[i].position_in_map_m.y());
    const double radius =
        std::clamp(0.5 * sources[i].extent_m * view.pixels_per_m, 6.0, 0.25 * view.width);
    const auto stroke = [&](const Rgb& color, double width) {
      SetColor(cr, color);
      cairo_set_line_width(cr, width);
      cairo_new_path(cr);
      cairo_arc(cr, x, y, radius, 0.0, 2.0 * 3.14159265358979);
      cairo_stroke(cr);
      cairo_move_to(cr, x - 5.0, y);
      cairo_line_to(cr, x + 5.0, y);
      cairo_move_to(cr, x, y - 5.0);
      cairo_line_to(cr, x, y + 5.0);
      cairo_stroke(cr);
    };
    stroke(kWhite, 4.5);
    stroke(kInk, 1.8);
    DrawBadge(cr, x + 0.707 * radius + 10.0, y - 0.707 * radius - 10.0, absl::StrCat(i + 1));
  }
}

void DrawColorBar(cairo_t* cr, double left, double top) {
  DrawText(cr, "Log-odds of a sound source", left, top, 14.0, Align::kLeft, true);
  DrawText(cr, "largest of each column of voxels", left, top + 19.0, 12.0, Align::kLeft, false,
           kSoftInk);
  const double bar_top = top + 40.0;
  const double bar_width = 26.0;
  for (int i = 0; i < static_cast<int>(kBarHeight); ++i) {
    const double log_odds = kColorLimit_log_odds * (1.0 - 2.0 * (i + 0.5) / kBarHeight);
    const Color color = ColorOfLogOdds(log_odds);
    SetColor(cr, {color.red / 255.0, color.green / 255.0, color.blue / 255.0});
    cairo_rectangle(cr, left, bar_top + i, bar_width, 1.5);
    cairo_fill(cr);
  }
  SetColor(cr, kFrame);
  cairo_set_line_width(cr, 1.0);
  cairo_rectangle(cr, left - 0.5, bar_top - 0.5, bar_width + 1.0, kBarHeight + 1.0);
  cairo_stroke(cr);
  const double half = 0.5 * kBarHeight;
  for (int tick = -4; tick <= 4; ++tick) {
    const double log_odds = kColorLimit_log_odds * tick / 4.0;
    const double y = std::round(bar_top + half * (1.0 - tick / 4.0)) + 0.5;
    SetColor(cr, kSoftInk);
    cairo_move_to(cr, left + bar_width, y);
    cairo_line_to(cr, left + bar_width + 6.0, y);
    cairo_stroke(cr);
    const char* sign = tick == 4    ? "≥ +"
                       : tick == -4 ? "≤ −"
                       : tick > 0   ? "+"
                       : tick < 0   ? "−"
                                    : "";
    const char* meaning = tick == 4    ? "a source"
                          : tick == 0  ? "undecided"
                          : tick == -4 ? "silent"
                                       : "";
    DrawText(cr, absl::StrFormat("%s%g", sign, std::abs(log_odds)), left + bar_width + 54.0,
             y + 4.5, 13.0, Align::kRight);
    DrawText(cr, meaning, left + bar_width + 68.0, y + 4.5, 13.0, Align::kLeft, false, kSoftInk);
  }
}

void DrawSourceTable(cairo_t* cr, double left, double top, double bottom,
                     std::span<const SoundSource> sources, double min_probability) {
  DrawText(cr, absl::StrFormat("Sound sources (p ≥ %g)", min_probability), left, top, 14.0,
           Align::kLeft, true);
  if (sources.empty()) {
    DrawText(cr, "none", left, top + 25.0, 13.0, Align::kLeft, false, kSoftInk);
    return;
  }
  const double columns[] = {left + 90.0, left + 150.0, left + 210.0, left + 272.0, left + 350.0};
  const char* const titles[] = {"x [m]", "y [m]", "z [m]", "p", "heard"};
  for (int i = 0; i < 5; ++i) {
    DrawText(cr, titles[i], columns[i], top + 24.0, 12.0, Align::kRight, false, kSoftInk);
  }
  double y = top + 50.0;
  for (std::size_t i = 0; i < sources.size(); ++i, y += kRowHeight) {
    const bool last_row = y + kRowHeight > bottom || i + 1 >= kMaxRows;
    if (last_row && i + 1 < sources.size()) {
      DrawText(cr, absl::StrCat("and ", sources.size() - i, " more"), left, y, 13.0, Align::kLeft,
               false, kSoftInk);
      return;
    }
    const SoundSource& source = sources[i];
    DrawBadge(cr, left + 11.0, y - 4.5, absl::StrCat(i + 1));
    const std::string cells[] = {absl::StrFormat("%.2f", source.position_in_map_m.x()),
                                 absl::StrFormat("%.2f", source.position_in_map_m.y()),
                                 absl::StrFormat("%.2f", source.position_in_map_m.z()),
                                 absl::StrFormat("%.3f", source.probability),
                                 absl::StrFormat("%d×", source.evidence_count)};
    for (int c = 0; c < 5; ++c) DrawText(cr, cells[c], columns[c], y, 13.0, Align::kRight);
  }
}

std::string Subtitle(const Snapshot& snapshot, const std::optional<PlanImage>& plan,
                     const PlanViewOptions& options) {
  if (options.floor_plan_only) {
    const double cell_size_m = plan ? plan->cell_size_m : 0.0;
    return absl::StrFormat("cells of %g cm: black is a wall, white is free, grey is unknown",
                           100.0 * cell_size_m);
  }
  std::string subtitle = absl::StrFormat("%d voxels of %g cm", snapshot.voxel_count(),
                                         100.0 * snapshot.voxel_size_m());
  if (options.min_updates > 0) {
    absl::StrAppend(&subtitle, ", shown with more than ", options.min_updates, " updates");
  }
  if (snapshot.as_of_ns()) {
    absl::StrAppend(&subtitle, absl::FormatTime(", as of %Y-%m-%d %H:%M:%S UTC",
                                                absl::FromUnixNanos(*snapshot.as_of_ns()),
                                                absl::UTCTimeZone()));
  }
  return subtitle;
}

cairo_status_t AppendBytes(void* closure, const unsigned char* data, unsigned int length) {
  static_cast<std::string*>(closure)->append(reinterpret_cast<const char*>(data), length);
  return CAIRO_STATUS_SUCCESS;
}

}  // namespace

absl::StatusOr<std::string> RenderPlanView(const Snapshot& snapshot,
                                           const std::optional<PlanImage>& plan,
                                           std::span<const SoundSource> sources,
                                           const PlanViewOptions& options) {
  if (plan && (plan->width < 0 || plan->height < 0 || !(plan->cell_size_m > 0.0) ||
               !plan->origin_in_map_m.allFinite() ||
               plan->cells.size() != static_cast<std::size_t>(plan->width) * plan->height)) {
    return absl::InvalidArgumentError("the cells of the floor plan do not fit its size");
  }
  std::vector<SoundSource> shown;
  for (const SoundSource& source : sources) {
    if (source.probability >= options.min_probability && source.position_in_map_m.allFinite()) {
      shown.push_back(source);
    }
  }
  View view = FitView(snapshot, plan, shown, options);
  const double body_height = std::max(view.height, kMinPlotHeight);
  view.top += 0.5 * (body_height - view.height);
  const double panel_left = view.left + view.width + kPanelGap;
  const double page_right =
      options.floor_plan_only ? view.left + view.width : panel_left + kPanelWidth;
  const int page_width = static_cast<int>(std::ceil(page_right + 24.0));
  const int page_height = static_cast<int>(std::ceil(kMarginTop + body_height + kMarginBottom));

  const Surface surface(cairo_image_surface_create(CAIRO_FORMAT_RGB24, page_width, page_height),
                        &cairo_surface_destroy);
  const Context context(cairo_create(surface.get()), &cairo_destroy);
  cairo_t* cr = context.get();
  SetColor(cr, kWhite);
  cairo_paint(cr);
  SetColor(cr, plan ? kUnknown : kWhite);
  cairo_rectangle(cr, view.left, view.top, view.width, view.height);
  cairo_fill(cr);

  if (plan) DrawPlan(cr, view, *plan, /*walls_only=*/false);
  DrawSound(cr, view, snapshot, options);
  if (plan) DrawPlan(cr, view, *plan, /*walls_only=*/true);
  DrawAxes(cr, view);
  DrawScaleBar(cr, view);
  DrawSources(cr, view, shown);

  DrawText(cr, options.title, view.left, 44.0, 22.0, Align::kLeft, true);
  DrawText(cr, Subtitle(snapshot, plan, options), view.left, 68.0, 13.0, Align::kLeft, false,
           kSoftInk);
  if (!options.floor_plan_only) {
    DrawColorBar(cr, panel_left, kMarginTop + 12.0);
    DrawSourceTable(cr, panel_left, kMarginTop + 12.0 + 40.0 + kBarHeight + 48.0,
                    kMarginTop + body_height, shown, options.min_probability);
  }

  std::string png;
  cairo_surface_flush(surface.get());
  const cairo_status_t status =
      cairo_surface_write_to_png_stream(surface.get(), &AppendBytes, &png);
  if (status != CAIRO_STATUS_SUCCESS) {
    return absl::InternalError(
        absl::StrCat("the plan view could not be drawn: ", cairo_status_to_string(status)));
  }
  return png;
}

}  // namespace soundmap::sound_map
