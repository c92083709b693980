#include "acoustics/harmonic_srp.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <numeric>

#include "acoustics/spherical_harmonics.h"
#include "geometry/angles.h"

namespace soundmap::acoustics {
namespace {

using geometry::kPi;

constexpr double kSameHeight = 1e-9;
// An order counts on a ring where a harmonic of it exceeds this, against a root mean square of 1.
constexpr double kNegligible = 1e-9;
constexpr int kMaxDegree = 500;
constexpr int kRings = 4;  // that one pass along the azimuths serves

// The lowest degree that a pair's series may be cut at; `phase_rad` is w |d|.
int DegreeFor(double phase_rad) {
  // Terms fall faster than any power of l beyond l = phase; this is far beyond.
  const int far = static_cast<int>(phase_rad + 40.0 + 6.0 * std::cbrt(phase_rad));
  const std::vector<double> j = SphericalBessel(far, phase_rad);
  double rest = 0.0;
  int degree = far;
  for (; degree > 0; --degree) {
    rest += (2.0 * degree + 1.0) * std::abs(j[degree]);
    if (rest > HarmonicSrp::kTruncation) break;
  }
  return degree;
}

// The orders of an azimuth table: cosines of even and of odd orders, sines of even and of odd ones.
constexpr std::array<int, 4> kFirstOrder = {0, 1, 2, 1};
int OrdersOf(int kind, int max_order) {
  return max_order < kFirstOrder[kind] ? 0 : (max_order - kFirstOrder[kind]) / 2 + 1;
}
int OrdersBefore(int kind, int max_order) {
  int orders = 0;
  for (int k = 0; k < kind; ++k) orders += OrdersOf(k, max_order);
  return orders;
}

}  // namespace

std::unique_ptr<const HarmonicSrp> HarmonicSrp::Create(const FrameLayout& layout,
                                                       const std::vector<Eigen::Vector3d>& delay_s,
                                                       const geometry::DirectionGrid& grid,
                                                       const Kernels& kernels) {
  const std::optional<RingGrid> rings = FindRings(grid);
  if (!rings) return nullptr;
  std::unique_ptr<HarmonicSrp> srp(new HarmonicSrp(kernels));
  if (!srp->Build(delay_s, layout, *rings, grid.size())) return nullptr;
  return srp;
}

bool HarmonicSrp::Build(const std::vector<Eigen::Vector3d>& delay_s, const FrameLayout& layout,
                        const RingGrid& grid, int directions) {
  const double max_rad_s = 2.0 * kPi * layout.bin_hz(layout.bins - 1);
  if (max_rad_s * delay_s.front().norm() > kMaxDegree) return false;
  bins_ = layout.bins;
  pairs_ = static_cast<int>(delay_s.size());
  centre_azimuth_rad_ = grid.centre_azimuth_rad;
  double floats = 0.0;  // of all tables, roughly
  for (int g = 0; g < pairs_; ++g) {
    const double length_s = delay_s[g].norm();
    constexpr double kSameLength = 1e-9;
    if (lengths_.empty() ||
        length_s < (1.0 - kSameLength) * delay_s[lengths_.back().first].norm()) {
      const int degree = DegreeFor(max_rad_s * length_s);
      lengths_.push_back({g, 0, degree});
      floats += static_cast<double>(bins_) * (degree + 1);
    }
    Length& length = lengths_.back();
    ++length.count;
    floats += (length.degree + 1.0) * (length.degree + 1.0);
  }
  degree_ = lengths_.front().degree;
  row_ = PaddedToRow(degree_ + 1);
  for (const Ring& ring : grid.rings) {
    floats += 0.5 * degree_ * degree_ + 2.0 * degree_ * ring.base_count();
  }
  // In steps along tables like these, of a pair: a look-up, and its correlation beforehand.
  constexpr double kLookUp = 4.0;
  constexpr double kCorrelation = 10000.0;
  if (floats > pairs_ * (kCorrelation + kLookUp * directions)) return false;
  BuildPairs(delay_s, layout);
  BuildRings(grid);
  BuildRecurrence();
  return true;
}

void HarmonicSrp::BuildPairs(const std::vector<Eigen::Vector3d>& delay_s,
                             const FrameLayout& layout) {
  even_ = PaddedToRow(degree_ / 2 + 1);
  odd_ = PaddedToRow((degree_ + 1) / 2);
  for (Length& length : lengths_) {
    length.table = bessel_.size();
    const int even = PaddedToRow(length.degree / 2 + 1);
    const int odd = PaddedToRow((length.degree + 1) / 2);
    bessel_.resize(length.table + static_cast<std::size_t>(bins_) * (even + odd));
    float* even_table = &bessel_[length.table];
    float* odd_table = even_table + static_cast<std::size_t>(bins_) * even;
    const double length_s = delay_s[length.first].norm();
    for (int b = 0; b < bins_; ++b) {
      const std::vector<double> j =
          SphericalBessel(length.degree, 2.0 * kPi * layout.bin_hz(b) * length_s);
      for (int l = 0; l <= length.degree; ++l) {
        // Re(C (-j)^l) is Re C, Im C, -Re C, -Im C, ..
        const double sign = l / 2 % 2 == 0 ? 1.0 : -1.0;
        (l % 2 == 0 ? even_table + b * even : odd_table + b * odd)[l / 2] =
            static_cast<float>(4.0 * kPi * sign * j[l]);
      }
    }
  }
  std::vector<int> degree_of_pair;
  for (const Length& length : lengths_) {
    degree_of_pair.insert(degree_of_pair.end(), length.count, length.degree);
  }
  for (int l = 0; l <= degree_; ++l) {
    pairs_of_degree_.push_back(static_cast<int>(std::count_if(
        degree_of_pair.begin(), degree_of_pair.end(), [l](int degree) { return degree >= l; })));
    pair_harmonics_at_.push_back(pair_harmonics_.size());
    pair_harmonics_.resize(pair_harmonics_.size() +
                           static_cast<std::size_t>(pairs_of_degree_[l]) * PaddedToRow(2 * l + 1));
  }
  for (int g = 0; g < pairs_; ++g) {
    const Eigen::Vector3d axis = delay_s[g].normalized();
    const std::vector<double> p = NormalizedLegendre(degree_of_pair[g], axis.z());
    const double azimuth_rad =
        geometry::AnglesFromDirection(axis).azimuth_rad - centre_azimuth_rad_;
    for (int l = 0; l <= degree_of_pair[g]; ++l) {
      float* row = &pair_harmonics_[pair_harmonics_at_[l] +
                                    static_cast<std::size_t>(g) * PaddedToRow(2 * l + 1)];
      for (int m = 0; m <= l; ++m) {
        const double value = p[LegendreIndex(l, m)];
        row[m] = static_cast<float>(value * std::cos(m * azimuth_rad));
        if (m > 0) row[l + m] = static_cast<float>(value * std::sin(m * azimuth_rad));
      }
    }
  }
}

void HarmonicSrp::BuildRings(const RingGrid& grid) {
  // Rings by height, the equator first; mirror images share their height.
  std::vector<int> order(grid.rings.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return std::abs(grid.rings[a].z) < std::abs(grid.rings[b].z) - kSameHeight;
  });
  std::vector<double> heights;
  for (const int r : order) {
    const double height = std::abs(grid.rings[r].z);
    if (heights.empty() || height > heights.back() + kSameHeight) heights.push_back(height);
    rings_.push_back({static_cast<int>(heights.size()) - 1, grid.rings[r].z < 0.0, grid.rings[r]});
  }
  heights_ = PaddedToRow(static_cast<int>(heights.size()));
  std::vector<std::vector<double>> p;
  for (const double height : heights) p.push_back(NormalizedLegendre(degree_, height));
  std::vector<int> max_order(heights.size(), 0);
  for (int m = 0; m <= degree_; ++m) {
    int count = 0;
    for (std::size_t h = 0; h < heights.size(); ++h) {
      double largest = 0.0;
      for (int l = m; l <= degree_; ++l) {
        largest = std::max(largest, std::abs(p[h][LegendreIndex(l, m)]));
      }
      if (largest <= kNegligible) continue;
      max_order[h] = m;
      count = static_cast<int>(h) + 1;
    }
    heights_of_order_.push_back(PaddedToRow(count));
    rings_of_order_.push_back(static_cast<int>(std::count_if(
        rings_.begin(), rings_.end(), [&](const RingPlace& ring) { return ring.height < count; })));
    for (int odd = 0; odd < 2; ++odd) {
      legendre_at_.push_back(legendre_.size());
      for (int l = m + odd; l <= degree_; l += 2) {
        for (int h = 0; h < heights_of_order_[m]; ++h) {
          legendre_.push_back(h < static_cast<int>(heights.size())
                                  ? static_cast<float>(p[h][LegendreIndex(l, m)])
                                  : 0.0f);
        }
      }
    }
  }
  for (int r = 0; r < static_cast<int>(rings_.size()); ++r) {
    const Ring& ring = rings_[r].ring;
    if (!arcs_.empty()) {
      const Ring& before = rings_[r - 1].ring;
      if (before.count == ring.count && before.circle == ring.circle &&
          std::abs(before.step_rad - ring.step_rad) < 1e-12) {
        ++arcs_.back().count;
        continue;
      }
    }
    Azimuths arc{r, 1, max_order[rings_[r].height], PaddedToRow(ring.base_count()),
                 azimuths_.size()};
    widest_ = std::max(widest_, arc.width);
    for (int kind = 0; kind < 4; ++kind) {
      for (int m = kFirstOrder[kind]; m <= arc.max_order; m += 2) {
        for (int i = 0; i < arc.width; ++i) {
          const double angle_rad = m * ring.base_azimuth_rad(i);
          const double value = kind < 2 ? std::cos(angle_rad) : std::sin(angle_rad);
          azimuths_.push_back(i < ring.base_count() ? static_cast<float>(value) : 0.0f);
        }
      }
    }
    arcs_.push_back(arc);
  }
}

void HarmonicSrp::BuildRecurrence() {
  factor_.resize(static_cast<std::size_t>(degree_ + 1) * row_);
  before_factor_.resize(factor_.size());
  for (int m = 0; m <= degree_; ++m) {
    sectoral_factor_.push_back(
        m == 0 ? 1.0 : std::sqrt((m == 1 ? 2.0 : 1.0) * (2.0 * m + 1.0) / (2.0 * m)));
    double before = 0.0;
    for (int l = m + 1; l <= degree_; ++l) {
      const double factor = std::sqrt((4.0 * l * l - 1.0) / (static_cast<double>(l * l) - m * m));
      factor_[static_cast<std::size_t>(l - m) * row_ + m] = factor;
      before_factor_[static_cast<std::size_t>(l - m) * row_ + m] = factor * before;
      before = 1.0 / factor;
    }
  }
}

std::size_t HarmonicSrp::workspace_floats() const {
  const std::size_t by_degree = static_cast<std::size_t>(pairs_) * (even_ + odd_);
  const std::size_t by_height = 4 * static_cast<std::size_t>(degree_ + 1) * heights_;
  const std::size_t by_order = rings_.size() * (2 * degree_ + 1);
  return std::max(by_degree + PaddedToRow(2 * degree_ + 1),
                  by_height + by_order + 4 * static_cast<std::size_t>(kRings) * widest_);
}

void HarmonicSrp::Expand(const float* real, const float* imaginary, int width, float scale,
                         float constant, float* workspace, std::vector<float>& harmonics) const {
  float* by_degree = workspace;
  float* of_degree = workspace + static_cast<std::ptrdiff_t>(pairs_) * (even_ + odd_);
  for (const Length& length : lengths_) {
    WeightedRows product;
    product.rows = bins_;
    product.sums = length.count;
    product.weight_stride = width;
    product.sum_stride = even_ + odd_;
    product.row = &bessel_[length.table];
    product.row_stride = product.width = PaddedToRow(length.degree / 2 + 1);
    product.weight = real + static_cast<std::ptrdiff_t>(length.first) * width;
    product.sum = by_degree + static_cast<std::ptrdiff_t>(length.first) * (even_ + odd_);
    kernels_.weigh_rows(product);
    product.row += bins_ * product.row_stride;
    product.row_stride = product.width = PaddedToRow((length.degree + 1) / 2);
    product.weight = imaginary + static_cast<std::ptrdiff_t>(length.first) * width;
    product.sum += even_;
    kernels_.weigh_rows(product);
  }
  harmonics.assign(2 * static_cast<std::size_t>(degree_ + 1) * row_, 0.0f);
  for (int l = 0; l <= degree_; ++l) {
    WeightedRows product;
    product.rows = pairs_of_degree_[l];
    product.row = &pair_harmonics_[pair_harmonics_at_[l]];
    product.row_stride = product.width = PaddedToRow(2 * l + 1);
    product.weight = by_degree + (l % 2 == 0 ? 0 : even_) + l / 2;
    product.weight_step = even_ + odd_;
    product.sums = 1;
    product.sum = of_degree;
    kernels_.weigh_rows(product);
    for (int m = 0; m <= l; ++m) harmonics[HarmonicIndex(l, m, false)] = scale * of_degree[m];
    for (int m = 1; m <= l; ++m) harmonics[HarmonicIndex(l, m, true)] = scale * of_degree[l + m];
  }
  harmonics[0] += static_cast<float>(constant * std::sqrt(4.0 * kPi));
}

void HarmonicSrp::Synthesize(std::span<const float> harmonics, float* workspace,
                             std::span<float> value) const {
  const int orders = 2 * degree_ + 1;
  // By order, parity of l - m, cosine or sine: heights.
  float* by_height = workspace;
  // By ring: orders of the four kinds.
  float* by_order = by_height + static_cast<std::ptrdiff_t>(4) * (degree_ + 1) * heights_;
  float* sums = by_order + static_cast<std::ptrdiff_t>(rings_.size()) * orders;
  for (int m = 0; m <= degree_; ++m) {
    for (int odd = 0; odd < 2 && m + odd <= degree_; ++odd) {
      WeightedRows product;
      product.row = &legendre_[legendre_at_[2 * m + odd]];
      product.row_stride = product.width = heights_of_order_[m];
      product.rows = (degree_ - m - odd) / 2 + 1;
      product.weight = &harmonics[HarmonicIndex(m + odd, m, false)];
      product.weight_stride = row_;
      product.weight_step = 4 * row_;
      product.sums = m == 0 ? 1 : 2;
      product.sum = by_height + static_cast<std::ptrdiff_t>(4 * m + 2 * odd) * heights_;
      product.sum_stride = heights_;
      kernels_.weigh_rows(product);
    }
  }
  for (int kind = 0, column = 0; kind < 4; ++kind) {
    for (int m = kFirstOrder[kind]; m <= degree_; m += 2, ++column) {
      const float* even = by_height + static_cast<std::ptrdiff_t>(4 * m + kind / 2) * heights_;
      const float* odd = even + 2 * static_cast<std::ptrdiff_t>(heights_);
      float* to = by_order + column;
      int r = 0;
      for (; r < rings_of_order_[m]; ++r, to += orders) {
        const float odd_part = m == degree_ ? 0.0f : odd[rings_[r].height];
        const float even_part = even[rings_[r].height];
        *to = rings_[r].south ? even_part - odd_part : even_part + odd_part;
      }
      for (; r < static_cast<int>(rings_.size()); ++r, to += orders) *to = 0.0f;
    }
  }
  for (const Azimuths& arc : arcs_) {
    for (int first = arc.first; first < arc.first + arc.count; first += kRings) {
      WeightedRows product;
      product.sums = std::min(kRings, arc.first + arc.count - first);
      product.row = &azimuths_[arc.table];
      product.row_stride = product.width = arc.width;
      product.weight_stride = orders;
      product.sum_stride = static_cast<std::ptrdiff_t>(4) * widest_;
      for (int kind = 0; kind < 4; ++kind) {
        product.rows = OrdersOf(kind, arc.max_order);
        product.weight =
            by_order + static_cast<std::ptrdiff_t>(first) * orders + OrdersBefore(kind, degree_);
        product.sum = sums + static_cast<std::ptrdiff_t>(kind) * widest_;
        kernels_.weigh_rows(product);
        product.row += static_cast<std::ptrdiff_t>(product.rows) * arc.width;
      }
      for (int k = 0; k < product.sums; ++k) {
        const Ring& ring = rings_[first + k].ring;
        const float* __restrict cos_even = sums + static_cast<std::ptrdiff_t>(4 * k) * widest_;
        const float* __restrict cos_odd = cos_even + widest_;
        const float* __restrict sin_even = cos_odd + widest_;
        const float* __restrict sin_odd = sin_even + widest_;
        float* __restrict out = &value[ring.first];
        const int base = ring.base_count();
        const int n = ring.count;
        if (ring.circle) {
          for (int i = 0; i < base; ++i) {
            const float near = cos_even[i] + cos_odd[i];
            const float far = cos_even[i] - cos_odd[i];
            const float near_sine = sin_even[i] + sin_odd[i];
            const float far_sine = sin_even[i] - sin_odd[i];
            out[i] = near + near_sine;
            out[n - 1 - i] = near - near_sine;
            out[n / 2 - 1 - i] = far - far_sine;
            out[n / 2 + i] = far + far_sine;
          }
        } else {
          for (int i = 0; i < base; ++i) {
            const float cosines = cos_even[i] + cos_odd[i];
            const float sines = sin_even[i] + sin_odd[i];
            out[n / 2 + i] = cosines + sines;
            out[n - 1 - n / 2 - i] = cosines - sines;
          }
        }
      }
    }
  }
}

double HarmonicSrp::ValueAt(std::span<const float> harmonics,
                            const Eigen::Vector3d& direction) const {
  const double z = direction.z();
  const double across = std::hypot(direction.x(), direction.y());
  const double azimuth_rad = std::atan2(direction.y(), direction.x()) - centre_azimuth_rad_;
  const int count = degree_ + 1;
  // By order: P_lm for the row of l - m at hand and the one before, and the sums over l.
  std::vector<double> work(4 * static_cast<std::size_t>(count));
  double* __restrict now = work.data();
  double* __restrict before = now + count;
  double* __restrict cosines = before + count;
  double* __restrict sines = cosines + count;
  double sectoral = std::sqrt(1.0 / (4.0 * kPi));
  for (int m = 0; m < count; ++m) {
    if (m > 0) sectoral *= sectoral_factor_[m] * across;
    now[m] = sectoral;
    cosines[m] = sectoral * harmonics[m];
    sines[m] = sectoral * harmonics[row_ + m];
  }
  for (int k = 1; k < count; ++k) {
    const double* __restrict factor = &factor_[static_cast<std::size_t>(k) * row_];
    const double* __restrict before_factor = &before_factor_[static_cast<std::size_t>(k) * row_];
    const float* __restrict cosine = &harmonics[2 * static_cast<std::size_t>(k) * row_];
    const float* __restrict sine = cosine + row_;
    for (int m = 0; m < count - k; ++m) {
      const double next = factor[m] * z * now[m] - before_factor[m] * before[m];
      before[m] = now[m];
      now[m] = next;
      cosines[m] += next * cosine[m];
      sines[m] += next * sine[m];
    }
  }
  const std::complex<double> turn = std::polar(1.0, azimuth_rad);
  std::complex<double> phase = 1.0;
  double sum = 0.0;
  for (int m = 0; m < count; ++m, phase *= turn) {
    sum += cosines[m] * phase.real() + sines[m] * phase.imag();
  }
  return sum;
}

}  // namespace soundmap::acoustics
