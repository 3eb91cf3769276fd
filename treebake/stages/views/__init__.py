"""View impostors: the whole tree in pictures from several sides ([I11])."""

from treebake.stages.views.views import ViewSettings, views

__all__ = ["ViewSettings", "views"]
