// What a correction of the particle filter costs, beside the same with a plain Bresenham caster.

#include <benchmark/benchmark.h>

#include <cmath>
#include <memory>
#include <random>

#include "localization/localizer.h"
#include "localization/synthetic_room.h"

namespace soundmap::localization {
namespace {

using geometry::Pose2;

const SyntheticRoom& Building() {
  static const SyntheticRoom building = OfficeFloor();
  return building;
}

const PreparedPlan& Plan() {
  static const auto plan = PreparedPlan::Create({}, Building().Plan()).value();
  return *plan;
}

constexpr Pose2 kPose{21.0, 10.1, 0.3};

std::vector<Beam> Beams(int count) {
  std::mt19937_64 engine(1);
  std::normal_distribution<double> noise_m(0.0, 0.02);
  std::vector<Beam> beams;
  for (int i = 0; i < count; ++i) {
    const double angle_rad = (1.5 * i / count - 0.75) * geometry::kPi;
    beams.push_back(
        {{0.0, 0.0},
         {std::cos(angle_rad), std::sin(angle_rad)},
         Building().Range(kPose.x_m, kPose.y_m, kPose.yaw_rad + angle_rad) + noise_m(engine)});
  }
  return beams;
}

std::vector<Particle> Particles(int count) {
  std::mt19937_64 engine(2);
  return Scatter(kPose, 0.1, 0.05, count, engine);
}

// Walks cell by cell to the first occupied one.
float BresenhamRange(const building::FloorPlan& plan, const Ray& ray, double max_range_m) {
  const double cells_per_m = 1.0 / plan.cell_size_m();
  const auto column_of = [&](double x_m) {
    return static_cast<int>(std::floor((x_m - plan.origin_in_map_m().x()) * cells_per_m));
  };
  const auto row_of = [&](double y_m) {
    return static_cast<int>(std::floor((y_m - plan.origin_in_map_m().y()) * cells_per_m));
  };
  int x = column_of(ray.x_m);
  int y = row_of(ray.y_m);
  const int x_end = column_of(ray.x_m + max_range_m * ray.direction_x);
  const int y_end = row_of(ray.y_m + max_range_m * ray.direction_y);
  const int begin_x = x;
  const int begin_y = y;
  const int dx = std::abs(x_end - x);
  const int dy = -std::abs(y_end - y);
  const int step_x = x < x_end ? 1 : -1;
  const int step_y = y < y_end ? 1 : -1;
  int error = dx + dy;
  while (plan.Contains(x, y) && plan.at(x, y) != building::Cell::kOccupied) {
    if (x == x_end && y == y_end) return static_cast<float>(max_range_m);
    const int twice = 2 * error;
    if (twice >= dy) {
      error += dy;
      x += step_x;
    }
    if (twice <= dx) {
      error += dx;
      y += step_y;
    }
  }
  return static_cast<float>(std::hypot(x - begin_x, y - begin_y) * plan.cell_size_m());
}

// Arguments: particles, beams.
void BM_Correction(benchmark::State& state) {
  const std::vector<Beam> beams = Beams(static_cast<int>(state.range(1)));
  const std::vector<Particle> begin = Particles(static_cast<int>(state.range(0)));
  const Config& config = Plan().config;
  std::mt19937_64 engine(3);
  const MotionModel motion(config.motion, {0.1, 0.0, 0.02});
  for (auto _ : state) {
    std::vector<Particle> particles = begin;
    Predict(motion, particles, engine);
    Correct(beams, Plan().caster, Plan().model, config.tempering, particles);
    benchmark::DoNotOptimize(particles =
                                 Resample(particles, static_cast<int>(begin.size()), engine));
  }
  state.SetItemsProcessed(state.iterations() * state.range(0) * state.range(1));
}
BENCHMARK(BM_Correction)
    ->Name("correction/ours")
    ->Args({200, 60})
    ->Args({200, 360})
    ->Unit(benchmark::kMicrosecond);

void BM_CorrectionByBresenham(benchmark::State& state) {
  const std::vector<Beam> beams = Beams(static_cast<int>(state.range(1)));
  const std::vector<Particle> begin = Particles(static_cast<int>(state.range(0)));
  const Config& config = Plan().config;
  const building::FloorPlan plan = Building().Plan();
  std::mt19937_64 engine(3);
  const MotionModel motion(config.motion, {0.1, 0.0, 0.02});
  for (auto _ : state) {
    std::vector<Particle> particles = begin;
    Predict(motion, particles, engine);
    for (Particle& particle : particles) {
      const double c = std::cos(particle.map_from_base.yaw_rad);
      const double s = std::sin(particle.map_from_base.yaw_rad);
      for (const Beam& beam : beams) {
        const Eigen::Vector2d& d = beam.direction_in_base;
        const Ray ray{static_cast<float>(particle.map_from_base.x_m),
                      static_cast<float>(particle.map_from_base.y_m),
                      static_cast<float>(c * d.x() - s * d.y()),
                      static_cast<float>(s * d.x() + c * d.y())};
        const Return expected{BresenhamRange(plan, ray, config.beam_model.max_range_m),
                              Ending::kWall};
        particle.log_weight +=
            config.tempering * Plan().model.Row(beam.range_m)[Plan().model.Column(expected)];
      }
    }
    benchmark::DoNotOptimize(particles.data());
  }
  state.SetItemsProcessed(state.iterations() * state.range(0) * state.range(1));
}
BENCHMARK(BM_CorrectionByBresenham)
    ->Name("correction/bresenham")
    ->Args({200, 60})
    ->Args({200, 360})
    ->Unit(benchmark::kMicrosecond);

// One sector of the search of a lost robot.
void BM_SearchOfASector(benchmark::State& state) {
  std::vector<Eigen::Vector2d> ends;
  for (const Beam& beam : Beams(200)) ends.push_back(beam.range_m * beam.direction_in_base);
  int sector = 0;
  for (auto _ : state) {
    benchmark::DoNotOptimize(Plan().search.Search(ends, sector++ % Plan().config.search.sectors));
  }
}
BENCHMARK(BM_SearchOfASector)->Name("search_of_a_sector/ours")->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace soundmap::localization
