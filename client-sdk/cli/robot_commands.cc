#include <algorithm>
#include <iostream>
#include <memory>
#include <numbers>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "cli/command_line.h"
#include "cli/evaluate.h"
#include "cli/json_output.h"
#include "cli/table.h"
#include "cli/time_text.h"

namespace soundmap::cli {
namespace {

constexpr double kDegPerRad = 180.0 / std::numbers::pi;

struct RobotArguments {
  std::string site;
  std::string robot;
  std::string session;
  bool path = false;
  std::string format;
};

// "+3.214 +-0.402", as it was when it was measured.
std::string OffsetText(const std::optional<ClockOffset>& offset) {
  if (!offset) return "-";
  return absl::StrFormat("%+.3f +-%.3f", 1e-6 * static_cast<double>(offset->server_minus_robot_ns),
                         1e-6 * static_cast<double>(offset->uncertainty_ns));
}

std::string LiveText(const std::optional<LiveView>& live) {
  if (!live) return "-";
  std::string text = live->recording ? "recording" : "recorded";
  if (live->map_from_base) {
    const Pose2& p = *live->map_from_base;
    absl::StrAppendFormat(&text, " at %.2f, %.2f, %.0f", p.x_m, p.y_m, p.yaw_rad * kDegPerRad);
  }
  absl::StrAppendFormat(&text, "; %.1f s ago", 1e-9 * static_cast<double>(live->age_ns));
  return text;
}

absl::Status ListRobots(Client& client, const RobotArguments& arguments) {
  auto robots = client.ListRobots(arguments.site);
  if (!robots.ok()) return robots.status();
  if (!arguments.robot.empty()) {
    std::erase_if(*robots, [&](const Robot& robot) { return robot.id != arguments.robot; });
    if (robots->empty()) {
      return absl::NotFoundError(
          absl::StrCat("the site ", arguments.site, " knows no robot ", arguments.robot));
    }
  }
  if (arguments.format == "json") {
    std::cout << ListToJson("robots", *robots).dump() << '\n';
    return absl::OkStatus();
  }
  using enum Table::Align;
  Table table({{"ROBOT"},
               {"SESSION"},
               {"STREAMING"},
               {"STATE"},
               {"X [m]", kRight},
               {"Y [m]", kRight},
               {"YAW [deg]", kRight},
               {"LOST FRAMES", kRight},
               {"LAST SEEN"},
               {"SERVER - ROBOT CLOCK [ms]", kRight},
               {"LIVE [m, deg]"}});
  for (const Robot& robot : *robots) {
    std::vector<std::string> pose = {"-", "-", "-", "-"};
    if (robot.pose) {
      const Pose2& p = robot.pose->map_from_base;
      pose = {NameOf(robot.pose->state), Fixed(p.x_m, 3), Fixed(p.y_m, 3),
              Fixed(p.yaw_rad * kDegPerRad, 1)};
    }
    table.Add({robot.id, robot.session, robot.streaming ? "yes" : "no", pose[0], pose[1], pose[2],
               pose[3], absl::StrCat(robot.lost_frames), FormatTime(robot.last_seen_ns),
               OffsetText(robot.clock_offset), LiveText(robot.live)});
  }
  table.Print(std::cout);
  return absl::OkStatus();
}

absl::StatusOr<Session> NewestSession(Client& client, const RobotArguments& arguments) {
  if (!arguments.session.empty()) return client.GetSession(arguments.site, arguments.session);
  const auto sessions = client.ListSessions(arguments.site, arguments.robot);
  if (!sessions.ok()) return sessions.status();
  const auto session = SessionToEvaluate(*sessions);
  if (!session) {
    return absl::NotFoundError(absl::StrCat(
        "the site ", arguments.site, " has no session",
        arguments.robot.empty() ? "" : absl::StrCat(" of the robot ", arguments.robot)));
  }
  return *session;
}

absl::Status PrintPath(Client& client, const RobotArguments& arguments) {
  const auto session = NewestSession(client, arguments);
  if (!session.ok()) return session.status();
  const auto path = client.GetTrajectory(arguments.site, session->id);
  if (!path.ok()) return path.status();
  if (arguments.format == "json") {
    Json document = {{"site", arguments.site}, {"session", session->id}, {"robot", session->robot}};
    document.update(ListToJson("path", *path));
    std::cout << document.dump() << '\n';
    return absl::OkStatus();
  }
  const bool tum = arguments.format == "tum";
  std::cout << (tum ? "# timestamp x y z qx qy qz qw\n" : "# timestamp_s,x,y,yaw\n");
  for (const PoseEstimate& pose : *path) {
    const Pose2& p = pose.map_from_base;
    const std::string time_s = FormatSeconds(pose.time_ns);
    if (tum) {
      std::cout << absl::StrFormat("%s %.6f %.6f 0 0 0 %.9f %.9f\n", time_s, p.x_m, p.y_m,
                                   std::sin(p.yaw_rad / 2.0), std::cos(p.yaw_rad / 2.0));
    } else {
      std::cout << absl::StrFormat("%s,%.6f,%.6f,%.6f\n", time_s, p.x_m, p.y_m, p.yaw_rad);
    }
  }
  return absl::OkStatus();
}

absl::Status ListSessions(Client& client, const RobotArguments& arguments) {
  auto sessions = client.ListSessions(arguments.site, arguments.robot);
  if (!sessions.ok()) return sessions.status();
  std::stable_sort(sessions->begin(), sessions->end(), [](const Session& a, const Session& b) {
    return a.create_time_ns != b.create_time_ns ? a.create_time_ns < b.create_time_ns : a.id < b.id;
  });
  if (arguments.format == "json") {
    std::cout << ListToJson("sessions", *sessions).dump() << '\n';
    return absl::OkStatus();
  }
  using enum Table::Align;
  Table table({{"SESSION"},
               {"ROBOT"},
               {"PURPOSE"},
               {"STATE"},
               {"RECEIVED", kRight},
               {"DURABLE", kRight},
               {"PROCESSED", kRight},
               {"SCANS", kRight},
               {"CREATED"},
               {"SERVER - ROBOT CLOCK [ms]", kRight},
               {"REMARKS"}});
  for (const Session& session : *sessions) {
    std::string remarks = session.error_message;
    for (const std::string& warning : session.warnings) {
      absl::StrAppend(&remarks, remarks.empty() ? "" : "; ", warning);
    }
    for (const FrameGap& gap : session.gaps) {
      absl::StrAppend(&remarks, remarks.empty() ? "" : "; ", "lost ", gap.frames,
                      " frames before frame ", gap.offset, ": ", gap.reason);
    }
    table.Add(
        {session.id, session.robot, NameOf(session.purpose), NameOf(session.state),
         absl::StrCat(session.received), absl::StrCat(session.durable),
         absl::StrCat(session.processed), absl::StrCat(session.audio_scans),
         FormatTime(session.create_time_ns),
         OffsetText(session.clock_offsets.empty() ? std::nullopt
                                                  : std::optional(session.clock_offsets.back())),
         remarks});
  }
  table.Print(std::cout);
  return absl::OkStatus();
}

}  // namespace

void AddRobotCommands(CLI::App& app, CommandLine& line) {
  auto robots = std::make_shared<RobotArguments>();
  CLI::App* command = AddCommand(app, "robots", "the robots of a site, or the path of one");
  command->add_option("SITE", robots->site, "id of the site")->required();
  command->add_option("--robot", robots->robot, "only this one");
  CLI::Option* path = command->add_flag("--path", robots->path,
                                        "the estimated path of the newest listening session");
  command->add_option("--session", robots->session, "the path of this session")->needs(path);
  command->add_option("--format", robots->format, "table or json; of a path csv, tum or json")
      ->check(CLI::IsMember({"table", "json", "csv", "tum"}));
  RunWithClient(*command, line, [robots](Client& client) {
    return robots->path ? PrintPath(client, *robots) : ListRobots(client, *robots);
  });
  // Also checked before anything is asked: which forms fit what is printed.
  command->parse_complete_callback([robots] {
    if (robots->format.empty()) robots->format = robots->path ? "csv" : "table";
    const bool of_path = robots->format == "csv" || robots->format == "tum";
    if (robots->format != "json" && of_path != robots->path) {
      throw CLI::ValidationError("--format: " + robots->format + " is for " +
                                 (of_path ? "--path" : "the list of robots"));
    }
  });

  auto sessions = std::make_shared<RobotArguments>();
  command = AddCommand(app, "sessions", "the sessions of a site: one is one drive of one robot");
  command->add_option("SITE", sessions->site, "id of the site")->required();
  command->add_option("--robot", sessions->robot, "only of this one");
  AddFormat(*command, sessions->format, {"table", "json"});
  RunWithClient(*command, line,
                [sessions](Client& client) { return ListSessions(client, *sessions); });
}

}  // namespace soundmap::cli
